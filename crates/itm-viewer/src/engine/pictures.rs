//! A frame's images as a window shows them.

use itm_slam::{Calibration, ColourImage, DepthImage};

/// The colour of a place on the scale that the map's depth is shown on, from 0 to 1.
pub(crate) fn scale_colour(share: f32) -> [u8; 3] {
    itm_gpu::reference::render::scale_colour(share.into()).to_array().map(|v| (v * 255.0).round() as u8)
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
