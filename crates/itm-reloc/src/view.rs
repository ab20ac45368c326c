//! What a relocaliser looks at.

use itm_core::{ColourImage, Image};

use crate::Error;

/// What the camera sees, smoothed and shrunk to some tens of pixels each way, so that two views from nearly the same place are
/// nearly the same.
///
/// It is made elsewhere, to the size and smoothing that `relocaliser.width`, `height` and `smoothing_px` ask for. What has no
/// depth should not have taken part in the smoothing.
#[derive(Clone, Debug, PartialEq)]
pub struct SmallView {
    depth: Image<f32>,
    colour: Option<ColourImage>,
}

impl SmallView {
    /// A view of depth in metres along the optical axis, 0 where there is none (whatever is not positive and finite becomes 0),
    /// and of colour, where there is any: red, green, blue and a byte that is 0 where a pixel has no colour.
    ///
    /// # Errors
    /// [`Error::ViewSize`] where the colour image has another size than the depth image.
    pub fn new(mut depth: Image<f32>, colour: Option<ColourImage>) -> Result<Self, Error> {
        if let Some(colour) = colour.as_ref().filter(|colour| colour.size() != depth.size()) {
            return Err(Error::ViewSize { what: "colour", expected: depth.size(), found: colour.size() });
        }
        for depth in depth.data_mut().iter_mut().filter(|depth| !(depth.is_finite() && **depth > 0.0)) {
            *depth = 0.0;
        }
        Ok(Self { depth, colour })
    }

    /// Width and height in pixels.
    pub fn size(&self) -> (u32, u32) {
        self.depth.size()
    }

    /// Depth in metres, row by row, 0 where there is none.
    pub fn depth(&self) -> &[f32] {
        self.depth.data()
    }

    /// Red, green, blue and a byte that is 0 where there is no colour, row by row, if the view has a colour image.
    pub fn colour(&self) -> Option<&[[u8; 4]]> {
        self.colour.as_ref().map(Image::data)
    }

    /// Share of the pixels that have depth, 0 to 1; 0 of an image without pixels.
    pub fn depth_share(&self) -> f64 {
        share(self.depth(), |depth| *depth > 0.0)
    }

    /// Share of the pixels that have a colour, 0 to 1; 0 without a colour image.
    pub fn colour_share(&self) -> f64 {
        share(self.colour().unwrap_or_default(), |colour| colour[3] != 0)
    }
}

fn share<T>(pixels: &[T], valid: impl Fn(&T) -> bool) -> f64 {
    pixels.iter().filter(|pixel| valid(pixel)).count() as f64 / pixels.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_depth_reads_as_none() {
        let depth = Image::new(5, 1, vec![f32::NAN, f32::INFINITY, -1.0, 0.0, 2.0]).unwrap();
        let view = SmallView::new(depth, None).unwrap();
        assert_eq!(view.depth(), [0.0, 0.0, 0.0, 0.0, 2.0]);
        assert_eq!((view.depth_share(), view.colour_share()), (0.2, 0.0));
    }

    #[test]
    fn colour_must_fit_the_depth() {
        let colour = Image::filled(1, 2, [9, 9, 9, 0]);
        let error = SmallView::new(Image::filled(2, 1, 1.0), Some(colour.clone())).unwrap_err();
        assert_eq!(error, Error::ViewSize { what: "colour", expected: (2, 1), found: (1, 2) });
        let view = SmallView::new(Image::filled(1, 2, 1.0), Some(colour)).unwrap();
        assert_eq!((view.depth_share(), view.colour_share()), (1.0, 0.0));
    }
}
