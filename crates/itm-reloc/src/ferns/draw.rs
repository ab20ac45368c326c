//! The tests that ferns are made of, drawn at random.

use itm_core::{RelocaliserImage, Settings};
use rand::Rng as _;
use rand_pcg::Pcg32;

use crate::SmallView;

/// What a test looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Channel {
    Depth,
    Red,
    Green,
    Blue,
}

/// Whether one pixel of one channel is above a threshold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Test {
    /// Index of the pixel in the small image, row by row.
    pub(super) pixel: u32,
    pub(super) channel: Channel,
    /// In metres, or 0 to 255.
    pub(super) threshold: f32,
}

impl Test {
    /// The outcome for a view of the size that the test was drawn for; what is not there is not above.
    pub(super) fn outcome(&self, view: &SmallView) -> bool {
        let pixel = self.pixel as usize;
        let colour = |channel: usize| {
            let colour = view.colour().map_or([0; 4], |colour| colour[pixel]);
            if colour[3] == 0 { 0.0 } else { f32::from(colour[channel]) }
        };
        let value = match self.channel {
            Channel::Depth => view.depth()[pixel],
            Channel::Red => colour(0),
            Channel::Green => colour(1),
            Channel::Blue => colour(2),
        };
        value > self.threshold
    }
}

/// The tests of all ferns, fern after fern.
///
/// They are drawn by O'Neill's PCG32 from the seed, by no more than the products below, so that a saved keyframe's codes mean the
/// same whatever becomes of a library's distributions.
pub(super) fn tests(settings: &Settings) -> Vec<Test> {
    let (view, relocaliser) = (&settings.view, &settings.relocaliser);
    let channels: &[Channel] = match relocaliser.image {
        RelocaliserImage::Depth => &[Channel::Depth],
        RelocaliserImage::Colour => &[Channel::Red, Channel::Green, Channel::Blue],
        RelocaliserImage::Both => &[Channel::Depth, Channel::Red, Channel::Green, Channel::Blue],
    };
    let pixels = u64::from(relocaliser.width * relocaliser.height);
    let mut random = Pcg32::new(u64::from(relocaliser.seed), 0);
    let mut test = |channel: Channel| {
        let pixel = ((u64::from(random.next_u32()) * pixels) >> 32) as u32;
        let (low, high) = match channel {
            Channel::Depth => (view.min_depth_m, view.max_depth_m),
            _ => (0.0, 255.0),
        };
        let share = f64::from(random.next_u32()) / f64::from(u32::MAX);
        let threshold = (f64::from(low) + share * (f64::from(high) - f64::from(low))) as f32;
        Test { pixel, channel, threshold }
    };
    let of_a_fern = (0..relocaliser.tests as usize).map(|index| channels[index % channels.len()]);
    (0..relocaliser.ferns).flat_map(|_| of_a_fern.clone()).map(&mut test).collect()
}

#[cfg(test)]
mod unit_tests {
    use super::*;
    use itm_core::{Image, RelocaliserSettings};

    fn drawn(relocaliser: RelocaliserSettings) -> Vec<Test> {
        tests(&Settings { relocaliser, ..Settings::default() })
    }

    #[test]
    fn the_draw_is_the_seeds_and_covers_image_and_range() {
        let settings = RelocaliserSettings { image: RelocaliserImage::Both, ferns: 2000, ..Default::default() };
        let all = drawn(settings.clone());
        assert_eq!(all, drawn(settings.clone()));
        assert_ne!(all, drawn(RelocaliserSettings { seed: 2, ..settings }));
        assert_eq!(all.len(), 8000);
        let fern = [Channel::Depth, Channel::Red, Channel::Green, Channel::Blue];
        assert!(all.chunks(4).all(|tests| tests.iter().map(|test| test.channel).eq(fern)));
        let mut hits = vec![0; 1200];
        all.iter().for_each(|test| hits[test.pixel as usize] += 1);
        assert!(hits.iter().filter(|&&hits| hits == 0).count() < 20, "{hits:?}");
        for (channel, low, high) in
            [(Channel::Depth, 0.2, 4.0), (Channel::Red, 0.0, 255.0), (Channel::Blue, 0.0, 255.0)]
        {
            let of_channel = all.iter().filter(|test| test.channel == channel).map(|test| test.threshold);
            let (least, most) = of_channel.fold((f32::MAX, f32::MIN), |(l, m), t| (l.min(t), m.max(t)));
            let margin = 0.01 * (high - low);
            assert!(low <= least && least < low + margin && high - margin < most && most <= high, "{least} to {most}");
        }
    }

    /// Saved keyframes rely on it.
    #[test]
    fn the_draw_never_changes() {
        let test = |pixel, threshold| Test { pixel, channel: Channel::Depth, threshold };
        assert_eq!(drawn(RelocaliserSettings::default())[..2], [test(1060, 0.215_840_16), test(990, 0.371_815_53)]);
    }

    #[test]
    fn what_is_not_there_is_not_above_a_threshold() {
        let depth = Image::new(2, 1, vec![0.0, 1.5]).unwrap();
        let colour = Image::new(2, 1, vec![[200, 200, 200, 0], [10, 20, 30, 255]]).unwrap();
        let view = SmallView::new(depth.clone(), Some(colour)).unwrap();
        let test = |pixel, channel, threshold| Test { pixel, channel, threshold };
        assert!(!test(0, Channel::Depth, 0.0).outcome(&view) && test(1, Channel::Depth, 1.4).outcome(&view));
        assert!(!test(1, Channel::Depth, 1.5).outcome(&view) && !test(0, Channel::Red, 0.0).outcome(&view));
        for (channel, value) in [(Channel::Red, 10.0), (Channel::Green, 20.0), (Channel::Blue, 30.0)] {
            assert!(test(1, channel, value - 1.0).outcome(&view) && !test(1, channel, value).outcome(&view));
        }
        assert!(!test(1, Channel::Blue, 0.0).outcome(&SmallView::new(depth, None).unwrap()));
    }
}
