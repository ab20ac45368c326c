//! What automatic exposure does to colours.

use std::f64::consts::TAU;

use itm_core::ColourImage;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

use crate::Error;
use crate::random::Stream;

/// Automatic exposure: from frame to frame, colours are brightened and shifted a little differently.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Smallest and largest gain, which no frame's leaves.
    pub gain: [f64; 2],
    /// Seconds from bright to dark and back: the slow change, a sine of time.
    pub period_s: f64,
    /// Largest share by which a frame's gain departs from the slow change, each by its own amount.
    pub gain_step: f64,
    /// Largest slow change of the offset, in steps of the 255 of a channel.
    pub offset: f64,
    /// Largest amount by which a frame's offset departs from that, in the same steps.
    pub offset_step: f64,
}

/// What exposure does to a channel of an image: `gain * value + offset`, in steps of the channel's 255, cut at its ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brightness {
    /// Factor of values as they are stored (sRGB).
    pub gain: f64,
    /// What is added, in steps.
    pub offset: f64,
}

impl Exposure {
    /// Gains from 0.6 to 1.6 within seven seconds, with steps of up to 3 % at each frame.
    pub const AUTO: Self = Self { gain: [0.6, 1.6], period_s: 7.0, gain_step: 0.03, offset: 6.0, offset_step: 1.5 };

    /// The brightness of frame number `frame` at a time in seconds; the same for the same seed.
    pub fn brightness(&self, seed: u64, frame: u64, time_s: f64) -> Brightness {
        let [phase, offset_phase] = {
            let mut random = Pcg32::seed_from_u64(Stream::Exposure.seed(seed, u64::MAX));
            [(); 2].map(|()| TAU * random.random::<f64>())
        };
        let mut random = Pcg32::seed_from_u64(Stream::Exposure.seed(seed, frame));
        let mut step = |most: f64| most * (2.0 * random.random::<f64>() - 1.0);
        let wave = |phase: f64, period_s: f64| (TAU * time_s / period_s + phase).sin();
        let [lo, hi] = self.gain;
        // Evenly in ratios: as much time is spent at half the gain as at twice.
        let slow = lo * (hi / lo).powf(0.5 + 0.5 * wave(phase, self.period_s));
        Brightness {
            gain: (slow * (1.0 + step(self.gain_step))).clamp(lo, hi),
            // Another period, so that offset and gain do not go together.
            offset: self.offset * wave(offset_phase, 0.61 * self.period_s) + step(self.offset_step),
        }
    }

    pub(crate) fn validate(&self) -> Result<(), Error> {
        let [lo, hi] = self.gain;
        for (name, value, ok) in [
            ("the smallest gain", lo, lo > 0.0 && lo.is_finite()),
            ("the largest gain", hi, hi >= lo && hi.is_finite()),
            ("the period of exposure in seconds", self.period_s, self.period_s > 0.0 && self.period_s.is_finite()),
        ] {
            if !ok {
                return Err(Error::Value {
                    name,
                    expected: "positive and finite, the largest not below",
                    found: value,
                });
            }
        }
        for (name, value) in [
            ("the step of gain", self.gain_step),
            ("the offset of exposure", self.offset),
            ("the step of offset", self.offset_step),
        ] {
            if !(0.0..=255.0).contains(&value) {
                return Err(Error::Value { name, expected: "between 0 and 255", found: value });
            }
        }
        Ok(())
    }
}

impl Brightness {
    /// What becomes of a channel's value.
    pub fn apply(&self, value: u8) -> u8 {
        (self.gain * f64::from(value) + self.offset).round().clamp(0.0, 255.0) as u8
    }

    pub(crate) fn apply_to(&self, colour: &mut ColourImage) {
        let table: [u8; 256] = std::array::from_fn(|v| self.apply(v as u8));
        for [r, g, b, _] in colour.data_mut() {
            (*r, *g, *b) = (table[usize::from(*r)], table[usize::from(*g)], table[usize::from(*b)]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_cover_their_range_slowly_and_in_small_steps() {
        let at = |i: u64| Exposure::AUTO.brightness(3, i, i as f64 / 30.0);
        let all: Vec<Brightness> = (0..420).map(at).collect();
        let (mut lo, mut hi) = (f64::MAX, f64::MIN);
        for b in &all {
            (lo, hi) = (lo.min(b.gain), hi.max(b.gain));
            assert!((0.6..=1.6).contains(&b.gain) && b.offset.abs() <= 7.5, "{b:?}");
        }
        assert!(lo < 0.65 && hi > 1.5, "from {lo} to {hi}");
        let changes: Vec<f64> = all.windows(2).map(|p| (p[1].gain / p[0].gain - 1.0).abs()).collect();
        assert!(changes.iter().all(|c| *c < 0.08));
        let mean = changes.iter().sum::<f64>() / changes.len() as f64;
        assert!((0.01..0.04).contains(&mean), "{mean} a frame");
        assert_ne!(at(0), Exposure::AUTO.brightness(4, 0, 0.0));
    }

    #[test]
    fn values_are_cut_at_their_ends() {
        let brightness = Brightness { gain: 1.5, offset: -4.0 };
        assert_eq!([0, 2, 100, 173, 255].map(|v| brightness.apply(v)), [0, 0, 146, 255, 255]);
    }
}
