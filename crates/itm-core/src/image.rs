//! Images in memory.

use thiserror::Error;

/// A row-major image of width x height values.
#[derive(Clone, Debug, PartialEq)]
pub struct Image<T> {
    width: u32,
    height: u32,
    data: Vec<T>,
}

/// A colour image: red, green, blue and a byte that is 0 where a pixel has no colour and anything else (mostly 255) where it
/// has one. A pixel is one 32-bit word on the GPU.
pub type ColourImage = Image<[u8; 4]>;

/// The number of values does not fit the size given.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("an image of {width}x{height} pixels needs {} values, not {found}", u64::from(*width) * u64::from(*height))]
pub struct ImageSizeError {
    /// Width asked for.
    pub width: u32,
    /// Height asked for.
    pub height: u32,
    /// Values given.
    pub found: usize,
}

impl<T> Image<T> {
    /// An image over values in row-major order.
    ///
    /// # Errors
    /// Where `data` does not hold width x height values.
    pub fn new(width: u32, height: u32, data: Vec<T>) -> Result<Self, ImageSizeError> {
        if data.len() as u64 == u64::from(width) * u64::from(height) {
            Ok(Self { width, height, data })
        } else {
            Err(ImageSizeError { width, height, found: data.len() })
        }
    }

    /// An image whose pixel `(x, y)` is `value(x, y)`.
    pub fn from_fn(width: u32, height: u32, mut value: impl FnMut(u32, u32) -> T) -> Self {
        let mut data = Vec::with_capacity(width as usize * height as usize);
        for y in 0..height {
            for x in 0..width {
                data.push(value(x, y));
            }
        }
        Self { width, height, data }
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Width and height in pixels.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// The values, row by row.
    pub fn data(&self) -> &[T] {
        &self.data
    }

    /// The values, row by row.
    pub fn data_mut(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// The values, row by row.
    pub fn into_data(self) -> Vec<T> {
        self.data
    }

    /// The value at a pixel, or `None` outside the image.
    pub fn get(&self, x: u32, y: u32) -> Option<&T> {
        (x < self.width && y < self.height).then(|| &self.data[self.width as usize * y as usize + x as usize])
    }
}

impl<T: Clone> Image<T> {
    /// An image of one value.
    pub fn filled(width: u32, height: u32, value: T) -> Self {
        Self { width, height, data: vec![value; width as usize * height as usize] }
    }
}

impl<T> std::ops::Index<(u32, u32)> for Image<T> {
    type Output = T;

    /// The value at column `x`, row `y`.
    ///
    /// # Panics
    /// Outside the image.
    fn index(&self, (x, y): (u32, u32)) -> &T {
        self.get(x, y).expect("pixel inside the image")
    }
}
