//! Reference of stage `view`: from a frame's images to what tracking and fusion use (the report, section 3; Newcombe et
//! al. 2011, section 3.2).

use glam::{DVec2, DVec3};
use itm_core::{ColourImage, DepthConversion, Distortion, Image, Intrinsics};

/// Raw depth to metres by a calibration's conversion; `focal_x` is the depth camera's, in pixels. Raw 0 and 65535, and
/// depths outside of the range (metres, ends included), become 0: no measurement.
pub fn convert_depth(
    raw: &Image<u16>,
    conversion: DepthConversion,
    focal_x: f64,
    depth_range_m: [f32; 2],
) -> Image<f32> {
    let metres = Image::from_fn(raw.width(), raw.height(), |x, y| {
        let value = raw[(x, y)];
        if value == 0 || value == u16::MAX {
            return 0.0;
        }
        let value = f64::from(value);
        let metres = match conversion {
            DepthConversion::Affine { scale, offset } => value * scale + offset,
            DepthConversion::Disparity { a, b } => 8.0 * b * focal_x / (a - value),
        };
        metres as f32
    });
    clip_depth(&metres, depth_range_m)
}

/// Depth in metres with all that is out of range, or not a number, set to 0: no measurement.
pub fn clip_depth(metres: &Image<f32>, [near_m, far_m]: [f32; 2]) -> Image<f32> {
    Image::from_fn(metres.width(), metres.height(), |x, y| {
        let z = metres[(x, y)];
        if (near_m..=far_m).contains(&z) { z } else { 0.0 }
    })
}

/// Where a lens's image shows what a pinhole camera of the same intrinsics sees at a pixel, or `None` where that is on none
/// of the image's pixels, each of which reaches half a pixel around its centre.
fn source(lens: &Distortion, camera: &Intrinsics, x: u32, y: u32) -> Option<DVec2> {
    let source = lens.distort_pixel(camera, DVec2::new(x.into(), y.into()));
    let size = DVec2::new(camera.width.into(), camera.height.into());
    (source.cmpge(DVec2::splat(-0.5)).all() && source.cmplt(size - 0.5).all()).then_some(source)
}

/// Depth of a camera with a lens to that of a pinhole camera with the same intrinsics: each pixel takes the nearest of the
/// lens's image, since interpolation would make up surfaces between foreground and background. Depth is along the optical
/// axis, which the lens leaves as it is. Pixels that the lens's image does not show become 0.
pub fn undistort_depth(depth: &Image<f32>, camera: &Intrinsics, lens: &Distortion) -> Image<f32> {
    Image::from_fn(depth.width(), depth.height(), |x, y| {
        let nearest = |at: DVec2| (at + 0.5).floor();
        source(lens, camera, x, y).map(nearest).map_or(0.0, |at| depth[(at.x as u32, at.y as u32)])
    })
}

/// Colour of a camera with a lens to that of a pinhole camera with the same intrinsics: each pixel is interpolated
/// bilinearly between four of the lens's image. All four bytes are 0 where that does not show it, or one of the four has no
/// colour.
pub fn undistort_colour(colour: &ColourImage, camera: &Intrinsics, lens: &Distortion) -> ColourImage {
    let last = DVec2::new((colour.width() - 1).into(), (colour.height() - 1).into());
    Image::from_fn(colour.width(), colour.height(), |x, y| {
        // The outer half of the outermost pixels has their colour.
        let Some(at) = source(lens, camera, x, y).map(|at| at.clamp(DVec2::ZERO, last)) else { return [0; 4] };
        let base = at.floor();
        let f = at - base;
        let texel = |offset: DVec2| {
            let p = (base + offset).min(last);
            colour[(p.x as u32, p.y as u32)]
        };
        let four = [DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::ONE].map(texel);
        if four.iter().any(|[.., alpha]| *alpha == 0) {
            return [0; 4];
        }
        let [a, b, c, d] = four.map(|[r, g, b, _]| DVec3::new(r.into(), g.into(), b.into()));
        let [r, g, b] = a.lerp(b, f.x).lerp(c.lerp(d, f.x), f.y).round().to_array().map(|v| v as u8);
        [r, g, b, 255]
    })
}

/// One 5x5 pass of a bilateral filter (Tomasi & Manduchi 1998, *Bilateral Filtering for Gray and Color Images*). The
/// spatial kernel is one pixel wide, the range kernel as wide as a Kinect's axial noise at the centre's depth,
/// 0.0012 + 0.0019 (z - 0.4)² metres (Nguyen et al. 2012).
pub fn bilateral(depth: &Image<f32>) -> Image<f32> {
    Image::from_fn(depth.width(), depth.height(), |x, y| {
        let z = f64::from(depth[(x, y)]);
        if z <= 0.0 {
            return 0.0;
        }
        let sigma = 0.0012 + 0.0019 * (z - 0.4).powi(2);
        let (mut sum, mut weights) = (0.0, 0.0);
        for j in y.saturating_sub(2)..=(y + 2).min(depth.height() - 1) {
            for i in x.saturating_sub(2)..=(x + 2).min(depth.width() - 1) {
                let other = f64::from(depth[(i, j)]);
                if other > 0.0 {
                    let squared_pixels = f64::from(i.abs_diff(x).pow(2) + j.abs_diff(y).pow(2));
                    let weight = (-0.5 * squared_pixels).exp() * (-0.5 * ((other - z) / sigma).powi(2)).exp();
                    sum += weight * other;
                    weights += weight;
                }
            }
        }
        (sum / weights) as f32
    })
}

/// The pixels of an image that a pixel of the halved one stands for, row by row; a side of one pixel has no second one.
fn group<T>(image: &Image<T>, x: u32, y: u32) -> [(u32, u32); 4] {
    let (last_x, last_y) = (image.width() - 1, image.height() - 1);
    let (right, below) = ((2 * x + 1).min(last_x), (2 * y + 1).min(last_y));
    [(2 * x, 2 * y), (right, 2 * y), (2 * x, below), (right, below)]
}

fn half<T>(image: &Image<T>) -> (u32, u32) {
    ((image.width() / 2).max(1), (image.height() / 2).max(1))
}

/// Halves a depth image: the mean of those of each 2x2 group that lie within `reach_m` of its first valid one, so that
/// foreground and background are not mixed (Newcombe et al. 2011, section 3.2).
pub fn halve_depth(depth: &Image<f32>, reach_m: f32) -> Image<f32> {
    let (width, height) = half(depth);
    Image::from_fn(width, height, |x, y| {
        let valid: Vec<f32> = group(depth, x, y).into_iter().map(|p| depth[p]).filter(|z| *z > 0.0).collect();
        let Some(&anchor) = valid.first() else { return 0.0 };
        let near: Vec<f64> = valid.iter().filter(|z| (*z - anchor).abs() <= reach_m).map(|z| f64::from(*z)).collect();
        (near.iter().sum::<f64>() / near.len() as f64) as f32
    })
}

/// A pixel's vertex, and its normal where it has one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Camera frame, metres.
    pub position: DVec3,
    /// Camera frame, unit length, towards the camera.
    pub normal: Option<DVec3>,
}

/// Vertices and normals of a depth image (Newcombe et al. 2011, section 3.2). Normals come from central differences; a
/// pixel has one where all four neighbours are there and lie within `reach_m` of it in depth: those `apart` pixels away or, where
/// one of them is not, the next ones.
pub fn vertices(depth: &Image<f32>, camera: &Intrinsics, reach_m: f32, apart: u32) -> Image<Option<Vertex>> {
    let position = |x: u32, y: u32| camera.unproject(DVec2::new(x.into(), y.into()), depth[(x, y)].into());
    Image::from_fn(depth.width(), depth.height(), |x, y| {
        let z = depth[(x, y)];
        if z <= 0.0 {
            return None;
        }
        let neighbour = |x: u32, y: u32| {
            depth.get(x, y).filter(|other| **other > 0.0 && (*other - z).abs() <= reach_m).map(|_| position(x, y))
        };
        let normal = |apart: u32| {
            let along_x = neighbour(x + apart, y)? - neighbour(x.checked_sub(apart)?, y)?;
            let along_y = neighbour(x, y + apart)? - neighbour(x, y.checked_sub(apart)?)?;
            let normal = along_x.cross(along_y).try_normalize()?;
            Some(if normal.dot(position(x, y)) > 0.0 { -normal } else { normal })
        };
        Some(Vertex { position: position(x, y), normal: normal(apart).or_else(|| normal(1)) })
    })
}

/// How much each pixel of a depth image counts in fusion, before it is rounded: `16 (σ(0.4) / σ(z))² cos θ`, at least 1, with
/// a Kinect's axial noise σ(z) = 0.0012 + 0.0019 (z - 0.4)² metres, best at 0.4 m (Nguyen et al. 2012), and θ between ray and
/// surface normal (Newcombe et al. 2011, section 3.3). Normals come from central differences over three pixels to either
/// side; where one of the four is missing or not within `reach_m` in depth, the cosine is taken as 0.
pub fn observation_weights(depth: &Image<f32>, camera: &Intrinsics, reach_m: f32) -> Image<f64> {
    const APART: u32 = 3;
    let sigma = |z: f64| 0.0012 + 0.0019 * (z - 0.4).max(0.0).powi(2);
    Image::from_fn(depth.width(), depth.height(), |x, y| {
        let z = depth[(x, y)];
        let neighbour = |x: u32, y: u32| {
            let near = depth.get(x, y).filter(|other| **other > 0.0 && (*other - z).abs() <= reach_m)?;
            Some(camera.unproject(DVec2::new(x.into(), y.into()), (*near).into()))
        };
        let cosine = || {
            let along_x = neighbour(x + APART, y)? - neighbour(x.checked_sub(APART)?, y)?;
            let along_y = neighbour(x, y + APART)? - neighbour(x, y.checked_sub(APART)?)?;
            let normal = along_x.cross(along_y).try_normalize()?;
            let ray = camera.unproject(DVec2::new(x.into(), y.into()), 1.0).normalize();
            Some(normal.dot(ray).abs())
        };
        let share = (sigma(0.4) / sigma(z.into())).powi(2) * cosine().unwrap_or(0.0);
        (16.0 * share).max(1.0)
    })
}

/// Halves a colour image: the mean of each 2x2 group, rounded to bytes; a group with a pixel that has no colour has none.
pub fn halve_colour(colour: &ColourImage) -> ColourImage {
    let (width, height) = half(colour);
    Image::from_fn(width, height, |x, y| {
        let pixels = group(colour, x, y).map(|p| colour[p]);
        if pixels.iter().any(|p| p[3] == 0) {
            return [0; 4];
        }
        std::array::from_fn(|c| (pixels.iter().map(|p| f64::from(p[c])).sum::<f64>() / 4.0).round() as u8)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn raw_depth_means_what_the_calibration_says() {
        let raw = Image::new(5, 1, vec![0, 65_535, 1500, 100, 4000]).unwrap();
        let metres = convert_depth(&raw, DepthConversion::MILLIMETRES, 500.0, [0.2, 3.0]);
        assert_eq!(metres.data(), &[0.0, 0.0, 1.5, 0.0, 0.0]);
        // A Kinect's disparities: 1135.09 at infinity, a baseline of 8.19141 cm.
        let conversion = DepthConversion::Disparity { a: 1135.09, b: 0.0819141 };
        let raw = Image::new(2, 1, vec![800, 1200]).unwrap();
        let metres = convert_depth(&raw, conversion, 573.71, [0.2, 3.0]);
        assert!((metres.data()[0] - 1.121_98).abs() < 1e-3, "{}", metres.data()[0]);
        assert_eq!(metres.data()[1], 0.0, "beyond infinity");
    }

    #[test]
    fn a_halved_image_has_the_means_of_its_groups() {
        let ramp = ColourImage::from_fn(9, 8, |x, y| [10 * x as u8, 20 * y as u8, 7, 255]);
        let halved = halve_colour(&ramp);
        assert_eq!(halved.size(), (4, 4));
        assert_eq!(halved[(1, 1)], [25, 50, 7, 255]);
        assert_eq!(halve_colour(&Image::filled(1, 1, [9; 4])).data(), &[[9; 4]]);
    }

    #[test]
    fn what_has_no_colour_spreads_to_what_is_made_of_it() {
        let colour = ColourImage::from_fn(8, 6, |x, y| [9, 9, 9, if (x, y) == (4, 3) { 0 } else { 255 }]);
        let halved = halve_colour(&colour);
        assert_eq!(halved[(2, 1)], [0; 4]);
        assert_eq!(halved.data().iter().filter(|c| c[3] == 0).count(), 1);
    }

    #[test]
    fn a_lens_moves_pixels_and_shows_none_beyond_its_image() {
        let camera = Intrinsics::new(5, 1, 10.0, 10.0, 2.0, 0.0);
        // A tangential term alone: at x = ±0.1, ±0.2 the shift is 3 p2 x², in pixels 0.5 and 2.
        let lens = Distortion::brown([0.0, 0.0, 0.0, 5.0 / 3.0, 0.0]);
        let depth = Image::new(5, 1, vec![1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        assert_eq!(undistort_depth(&depth, &camera, &lens).data(), &[3.0, 3.0, 3.0, 5.0, 0.0]);
        let grey = |v: u8| [v, v, v, 255];
        let colour = Image::new(5, 1, [10, 20, 30, 40, 50].map(grey).to_vec()).unwrap();
        let found = undistort_colour(&colour, &camera, &lens);
        assert_eq!(found.data(), &[grey(30), grey(25), grey(30), grey(45), [0; 4]]);
        let gap = Image::new(5, 1, vec![grey(10), grey(20), [30, 30, 30, 0], grey(40), grey(50)]).unwrap();
        assert_eq!(undistort_colour(&gap, &camera, &lens).data(), &[[0; 4], [0; 4], [0; 4], grey(45), [0; 4]]);
    }

    #[test]
    fn halving_and_smoothing_keep_depth_edges() {
        let edge = Image::from_fn(8, 8, |x, _| if x < 3 { 1.0 } else { 2.0 });
        assert_eq!(
            halve_depth(&edge, 0.1)[(1, 0)],
            1.0,
            "the group that the edge crosses takes its first pixel's side"
        );
        let smooth = bilateral(&edge);
        assert!(smooth.data().iter().zip(edge.data()).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn the_normals_of_a_tilted_plane_are_its_own() {
        let camera = Intrinsics::new(40, 30, 40.0, -40.0, 19.5, 14.5);
        let normal = DVec3::new(0.3, -0.2, -1.0).normalize();
        // The plane through (0, 0, 2): z from n · (ray z - (0, 0, 2)) = 0.
        let depth = Image::from_fn(40, 30, |x, y| {
            let ray = camera.unproject(DVec2::new(x.into(), y.into()), 1.0);
            (2.0 * normal.z / normal.dot(ray)) as f32
        });
        let vertices = vertices(&depth, &camera, 0.5, 1);
        assert!(vertices[(20, 15)].unwrap().normal.unwrap().abs_diff_eq(normal, 1e-5));
        assert_eq!(vertices[(0, 15)].unwrap().normal, None, "no left neighbour");
    }
}
