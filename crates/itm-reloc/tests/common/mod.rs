//! Views for tests.

use itm_core::{ColourImage, Image, RelocaliserSettings, Settings};
use itm_reloc::{Ferns, SmallView};

/// A wall across the view, 40x30 pixels: depth in metres at the left and at the right, in colours of its own.
pub(crate) fn wall(left_m: f32, right_m: f32) -> SmallView {
    let depth = Image::from_fn(40, 30, |x, _| left_m + (right_m - left_m) * x as f32 / 39.0);
    let colour =
        ColourImage::from_fn(40, 30, |x, y| [(50.0 * left_m) as u8, (50.0 * right_m) as u8, (x + y) as u8, 255]);
    SmallView::new(depth, Some(colour)).unwrap()
}

pub(crate) fn ferns(relocaliser: RelocaliserSettings) -> Ferns {
    Ferns::new(&Settings { relocaliser, ..Settings::default() }).unwrap()
}
