//! Something held over the lens.

use std::f64::consts::TAU;

use glam::DVec2;
use itm_core::{ColourImage, Image};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

use crate::Error;
use crate::random::Stream;

/// A hand over the lens for a part of the path's time.
///
/// It is too near for a depth camera, which reports nothing where it is, and so dark that colour shows a dark brown,
/// black where no light gets past it. It comes from a side that the seed chooses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cover {
    /// How much of the image it hides.
    pub covering: Covering,
    /// Start and end as shares of the path's duration, between 0 and 1; again in each repetition.
    pub during: [f64; 2],
}

/// How much of the image a [`Cover`] hides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Covering {
    /// All of it.
    Wholly,
    /// A share of it, between 0 and 1.
    Partly(f64),
    /// Ever more of it in the first third of the time until all is hidden, all in the second, ever less in the last.
    Gradually,
}

impl Cover {
    /// All of the image from 40 to 70 % of the time.
    pub const WHOLLY: Self = Self { covering: Covering::Wholly, during: [0.4, 0.7] };
    /// Three fifths of the image from 40 to 70 % of the time.
    pub const PARTLY: Self = Self { covering: Covering::Partly(0.6), during: [0.4, 0.7] };
    /// Growing and shrinking from 30 to 80 % of the time.
    pub const GRADUALLY: Self = Self { covering: Covering::Gradually, during: [0.3, 0.8] };

    /// Share of the image that is hidden at a time, for a path that takes `duration_s`.
    pub fn share(&self, time_s: f64, duration_s: f64) -> f64 {
        let at = (time_s / duration_s).rem_euclid(1.0);
        let [from, until] = self.during;
        if !(from..until).contains(&at) {
            return 0.0;
        }
        match self.covering {
            Covering::Wholly => 1.0,
            Covering::Partly(share) => share,
            Covering::Gradually => {
                let along = (at - from) / (until - from);
                (3.0 * along.min(1.0 - along)).clamp(0.0, 1.0)
            }
        }
    }

    pub(crate) fn validate(&self) -> Result<(), Error> {
        let share = if let Covering::Partly(share) = self.covering { share } else { 1.0 };
        let [from, until] = self.during;
        for (name, value, ok) in [
            ("the covered share of the image", share, (0.0..=1.0).contains(&share)),
            ("the start of the cover", from, (0.0..=1.0).contains(&from)),
            ("the end of the cover", until, until >= from && until <= 1.0),
        ] {
            if !ok {
                return Err(Error::Value {
                    name,
                    expected: "between 0 and 1, the end not before the start",
                    found: value,
                });
            }
        }
        Ok(())
    }
}

/// The pixels, by number in the image, that a hand hides when it hides a share of the image.
///
/// Their number is that share of all to the nearest pixel; a larger share hides the same and more.
fn hidden((width, height): (u32, u32), share: f64, seed: u64) -> Vec<u32> {
    let mut random = Pcg32::seed_from_u64(Stream::Cover.seed(seed, 0));
    let (side, fingers) = (TAU * random.random::<f64>(), TAU * random.random::<f64>());
    let inwards = DVec2::from_angle(side);
    let count = width * height;
    // How far in from the hand's side a pixel lies, the hand's outline being a little wavy.
    let depth: Vec<f64> = (0..count)
        .map(|i| {
            let at = DVec2::new(f64::from(i % width) + 0.5, f64::from(i / width) + 0.5);
            let at = at / DVec2::new(f64::from(width), f64::from(height)) - 0.5;
            at.dot(inwards) + 0.035 * (3.0 * TAU * at.dot(inwards.perp()) + fingers).cos()
        })
        .collect();
    let mut pixels: Vec<u32> = (0..count).collect();
    let many = (share.clamp(0.0, 1.0) * f64::from(count)).round() as usize;
    if many < pixels.len() {
        pixels.select_nth_unstable_by(many, |&a, &b| depth[a as usize].total_cmp(&depth[b as usize]).then(a.cmp(&b)));
        pixels.truncate(many);
    }
    pixels
}

/// Depth behind a hand that hides a share of the image.
pub(crate) fn cover_depth(depth: &mut Image<f32>, share: f64, seed: u64) {
    for i in hidden(depth.size(), share, seed) {
        depth.data_mut()[i as usize] = 0.0;
    }
}

/// Colour behind a hand that hides a share of the image.
pub(crate) fn cover_colour(colour: &mut ColourImage, share: f64, seed: u64) {
    // The less of the lens is free, the less light falls on the hand.
    let [r, g, b] = [44.0, 27.0, 20.0].map(|c: f64| (c * (1.0 - share)).round() as u8);
    for i in hidden(colour.size(), share, seed) {
        colour.data_mut()[i as usize] = [r, g, b, 255];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_over_time_are_what_was_asked_for() {
        let at = |cover: Cover, share: f64| cover.share(share * 8.0, 8.0);
        for (share, wholly, partly) in
            [(0.39, 0.0, 0.0), (0.41, 1.0, 0.6), (0.69, 1.0, 0.6), (0.71, 0.0, 0.0), (1.5, 1.0, 0.6)]
        {
            assert_eq!((at(Cover::WHOLLY, share), at(Cover::PARTLY, share)), (wholly, partly), "at {share}");
        }
        for (share, expected) in
            [(0.2, 0.0), (0.3, 0.0), (0.38333333, 0.5), (0.55, 1.0), (0.6, 1.0), (0.75, 0.3), (0.81, 0.0)]
        {
            let found = at(Cover::GRADUALLY, share);
            assert!((found - expected).abs() < 1e-6, "{found} at {share}");
        }
    }

    #[test]
    fn as_many_pixels_are_hidden_as_was_asked_for_and_more_hide_the_same() {
        for seed in 0..8 {
            let mut last: Vec<u32> = Vec::new();
            for share in [0.0, 0.1, 0.25, 0.6, 0.999, 1.0] {
                let mut pixels = hidden((37, 23), share, seed);
                pixels.sort_unstable();
                assert_eq!(pixels.len(), (share * 37.0 * 23.0).round() as usize);
                assert!(last.iter().all(|p| pixels.binary_search(p).is_ok()), "what was hidden stays hidden");
                last = pixels;
            }
        }
        assert_ne!(hidden((8, 6), 0.5, 1), hidden((8, 6), 0.5, 2), "hands come from any side");
        assert_eq!(hidden((1, 1), 0.4, 0).len(), 0);
    }
}
