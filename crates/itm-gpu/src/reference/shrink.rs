//! Reference of stage `shrink`: the small, smooth images that a relocaliser compares (Glocker et al. 2015, section 3).

use glam::DVec3;
use itm_core::Image;

/// Shrinks an image, whose pixels may hold nothing, to a width and height: each pixel is the mean over its cell of at least
/// one pixel, smoothed by a Gaussian (standard deviation in pixels of the small image, 0 for none) over the cells by how much
/// they hold. A pixel whose cell is less than half filled holds nothing.
pub fn shrink(image: &Image<Option<DVec3>>, (width, height): (u32, u32), sigma: f64) -> Image<Option<DVec3>> {
    let means = Image::from_fn(width, height, |x, y| {
        let [columns, rows] = [cell(x, image.width(), width), cell(y, image.height(), height)];
        let count = columns.len() * rows.len();
        let held: Vec<DVec3> =
            rows.flat_map(|row| columns.clone().map(move |column| (column, row))).filter_map(|at| image[at]).collect();
        let mean = if held.is_empty() { DVec3::ZERO } else { held.iter().sum::<DVec3>() / held.len() as f64 };
        (mean, held.len() as f64 / count as f64)
    });
    let reach = (3.0 * sigma).ceil() as u32;
    Image::from_fn(width, height, |x, y| {
        if means[(x, y)].1 < 0.5 {
            return None;
        }
        let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
        for row in y.saturating_sub(reach)..=(y + reach).min(height - 1) {
            for column in x.saturating_sub(reach)..=(x + reach).min(width - 1) {
                let (mean, share) = means[(column, row)];
                let off = f64::from(column.abs_diff(x).pow(2) + row.abs_diff(y).pow(2));
                let weight = if sigma > 0.0 { share * (-0.5 * off / (sigma * sigma)).exp() } else { share };
                sum += weight * mean;
                weights += weight;
            }
        }
        Some(sum / weights)
    })
}

/// The pixels along one axis that a pixel of the small image stands for.
fn cell(pixel: u32, size: u32, small_size: u32) -> std::ops::Range<u32> {
    let first = pixel * size / small_size;
    first..((pixel + 1) * size / small_size).max(first + 1)
}
