//! A frame's images as a window shows them.

use itm_slam::{Calibration, ColourImage, DepthImage};

/// The scale of colours 'viridis' (Smith & van der Walt, CC0) at nine steps, with straight lines between; the one that the
/// map's depth is shown on.
const STEPS: [[f32; 3]; 9] = [
    [68.0, 1.0, 84.0],
    [71.0, 44.0, 122.0],
    [59.0, 81.0, 139.0],
    [44.0, 113.0, 142.0],
    [33.0, 144.0, 141.0],
    [39.0, 173.0, 129.0],
    [92.0, 200.0, 99.0],
    [170.0, 220.0, 50.0],
    [253.0, 231.0, 37.0],
];

/// The colour of a place on the scale, from 0 to 1.
pub(crate) fn scale_colour(share: f32) -> [u8; 3] {
    let place = share.clamp(0.0, 1.0) * 8.0;
    let below = (place as usize).min(7);
    let part = place - below as f32;
    std::array::from_fn(|i| (STEPS[below][i] + (STEPS[below + 1][i] - STEPS[below][i]) * part).round() as u8)
}

/// Depth on the scale of colours, from 0 to a depth in metres; black where nothing was measured or it is out of range.
pub(crate) fn depth_picture(depth: &DepthImage, calibration: &Calibration, range_m: [f32; 2]) -> ColourImage {
    let (width, height) = depth.size();
    let table: Vec<[u8; 4]> = (0..=255u16).map(|i| opaque(scale_colour(f32::from(i) / 255.0))).collect();
    let paint = |metres: f32| {
        let there = metres.is_finite() && metres > 0.0 && (range_m[0]..=range_m[1]).contains(&metres);
        if there { table[(metres / range_m[1] * 255.0) as usize & 255] } else { [0, 0, 0, 255] }
    };
    let data = match depth {
        DepthImage::Raw(raw) => raw.data().iter().map(|&raw| paint(calibration.metres(raw))).collect(),
        DepthImage::Metres(metres) => metres.data().iter().map(|&metres| paint(metres)).collect(),
    };
    ColourImage::new(width, height, data).expect("as many values as pixels")
}

fn opaque([r, g, b]: [u8; 3]) -> [u8; 4] {
    [r, g, b, 255]
}

#[cfg(test)]
mod tests {
    use itm_slam::{DepthConversion, Image, Intrinsics};

    use super::*;

    #[test]
    fn depth_is_dark_near_bright_far_and_black_where_there_is_none() {
        let camera = Intrinsics::new(4, 1, 1.0, 1.0, 0.0, 0.0);
        let calibration = Calibration::registered(camera, DepthConversion::MILLIMETRES);
        let raw = Image::new(4, 1, vec![0, 300, 3900, 5000]).unwrap();
        let picture = depth_picture(&DepthImage::Raw(raw), &calibration, [0.2, 4.0]);
        let [none, near, far, beyond] = picture.data() else { panic!("four pixels") };
        assert_eq!((none, beyond), (&[0, 0, 0, 255], &[0, 0, 0, 255]));
        let brightness = |c: &[u8; 4]| c[..3].iter().map(|v| u32::from(*v)).sum::<u32>();
        assert!(brightness(near) < brightness(far));
        // The same in metres.
        let metres = Image::new(4, 1, vec![f32::NAN, 0.3, 3.9, f32::INFINITY]).unwrap();
        assert_eq!(depth_picture(&DepthImage::Metres(metres), &calibration, [0.2, 4.0]), picture);
    }
}
