//! Random numbers that depend on a seed and on what they are for, never on the order in which threads ask.

use rand::{Rng, RngExt};

/// What a sequence of random numbers is for.
#[derive(Clone, Copy)]
pub(crate) enum Stream {
    Depth,
    Inertial,
    Cover,
    Exposure,
}

impl Stream {
    /// A seed for item `index` (a frame, a reading) of this stream.
    pub(crate) fn seed(self, seed: u64, index: u64) -> u64 {
        let salt = match self {
            Self::Depth => 0x6465_7074,
            Self::Inertial => 0x696d_7520,
            Self::Cover => 0x636f_7672,
            Self::Exposure => 0x6578_706f,
        };
        mix(mix(mix(seed) ^ salt) ^ index)
    }
}

/// The finaliser of SplitMix64 (Steele et al. 2014): every bit of the input changes half of the output's.
fn mix(v: u64) -> u64 {
    let mut z = v.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A normally distributed number with mean 0 and standard deviation 1 (Box and Muller 1958).
pub(crate) fn gaussian(random: &mut impl Rng) -> f64 {
    let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.random::<f64>()).cos()
}
