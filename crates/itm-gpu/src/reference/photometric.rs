//! Reference of stage `photometric`: the sums of the colour term, surface points with colours against the live image (the
//! report, sections 3.1.2 and 3.1.3; Whelan et al. 2014, section 3.2; Steinbrücker et al. 2011).

use glam::{DVec2, DVec3};
use itm_core::{ColourImage, Image, Intrinsics, Se3};

use super::icp::weight_by_depth;
use super::map::{Map, corners};
use crate::PhotometricSums;
use crate::photometric::PhotometricTerm;

/// A surface point (world frame, metres) and its colour, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColouredPoint {
    /// World frame, metres.
    pub position: DVec3,
    /// Red, green, blue.
    pub colour: DVec3,
}

/// An image's colour at a place between pixels, and its derivatives along x and y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Red, green, blue, 0 to 1.
    pub value: DVec3,
    /// Per pixel.
    pub along_x: DVec3,
    /// Per pixel.
    pub along_y: DVec3,
}

/// A sample of an image between the four pixels around a place; `None` where one of them is outside or has no colour.
pub fn sample(image: &ColourImage, pixel: DVec2) -> Option<Sample> {
    let last = DVec2::new((image.width() - 1).into(), (image.height() - 1).into());
    if pixel.min_element() < 0.0 || pixel.x > last.x || pixel.y > last.y {
        return None;
    }
    let base = pixel.floor();
    let f = pixel - base;
    let texel = |p: DVec2| {
        let p = p.min(last);
        let [r, g, b, a] = image[(p.x as u32, p.y as u32)];
        (a > 0).then(|| DVec3::new(r.into(), g.into(), b.into()) / 255.0)
    };
    let (a, b) = (texel(base)?, texel(base + DVec2::X)?);
    let (c, d) = (texel(base + DVec2::Y)?, texel(base + DVec2::ONE)?);
    Some(Sample {
        value: a.lerp(b, f.x).lerp(c.lerp(d, f.x), f.y),
        along_x: (b - a).lerp(d - c, f.y),
        along_y: (c - a).lerp(d - b, f.x),
    })
}

/// The colour that a view shows at a surface point, taken to be its colour camera's.
pub fn previous(
    points: &Image<Option<DVec3>>,
    stride: u32,
    image: &ColourImage,
    camera: &Intrinsics,
    world_from_colour: &Se3,
) -> Image<Option<ColouredPoint>> {
    list(points, stride, |position| {
        let pixel = camera.project(world_from_colour.inverse().transform_point(position))?;
        Some(sample(image, pixel)?.value)
    })
}

/// The map's colour at a surface point: the mean of the eight voxels around, weighted trilinearly, over those that hold one.
pub fn map(points: &Image<Option<DVec3>>, stride: u32, map: &Map) -> Image<Option<ColouredPoint>> {
    list(points, stride, |position| {
        let position = position / f64::from(map.voxel_size_m);
        let base = position.floor();
        let f = position - base;
        let (mut sum, mut weights) = (DVec3::ZERO, 0.0);
        for corner in corners() {
            let voxel = map.colour(base.as_ivec3() + corner);
            if voxel.weight() > 0 {
                let share = |f: f64, c: i32| if c == 1 { f } else { 1.0 - f };
                let w = share(f.x, corner.x) * share(f.y, corner.y) * share(f.z, corner.z) + 1e-4;
                sum += w * DVec3::from_array(voxel.rgb().map(|v| f64::from(v) / 255.0));
                weights += w;
            }
        }
        (weights > 0.0).then(|| sum / weights)
    })
}

fn list(
    points: &Image<Option<DVec3>>,
    stride: u32,
    colour: impl Fn(DVec3) -> Option<DVec3>,
) -> Image<Option<ColouredPoint>> {
    let last = (points.width() - 1, points.height() - 1);
    Image::from_fn(points.width().div_ceil(stride).max(1), points.height().div_ceil(stride).max(1), |x, y| {
        let at = ((x * stride + stride / 2).min(last.0), (y * stride + stride / 2).min(last.1));
        let position = points[at]?;
        Some(ColouredPoint { position, colour: colour(position)? })
    })
}

/// A list halved along both axes: the mean of those points of a 2x2 group that lie within a distance of its first one,
/// which is `reach` metres for each metre between that one and the camera. A side of one cell has no second one.
pub fn halve(list: &Image<Option<ColouredPoint>>, reach: f64, camera: DVec3) -> Image<Option<ColouredPoint>> {
    Image::from_fn(list.width().div_ceil(2), list.height().div_ceil(2), |x, y| {
        let group = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| list.get(2 * x + i, 2 * y + j).copied().flatten());
        let first = group.into_iter().flatten().next()?.position;
        let near = |p: &ColouredPoint| p.position.distance(first) <= reach * first.distance(camera);
        let points: Vec<_> = group.into_iter().flatten().filter(near).collect();
        let mean = |of: fn(&ColouredPoint) -> DVec3| points.iter().map(of).sum::<DVec3>() / points.len() as f64;
        Some(ColouredPoint { position: mean(|p| p.position), colour: mean(|p| p.colour) })
    })
}

/// Derivatives of a point's expected less its seen value by translation, rotation (of the camera, about the pivot), gain and
/// offset, where `along` is the image's derivative along x and y, and `value` what the gain multiplies.
pub fn jacobian(
    position: DVec3,
    pivot: DVec3,
    camera: &Intrinsics,
    world_from_colour: &Se3,
    along: DVec2,
    value: f64,
) -> [f64; 8] {
    let p = world_from_colour.inverse().transform_point(position);
    let scaled = along * DVec2::new(camera.fx, camera.fy) / p.z;
    let by_point = DVec3::new(scaled.x, scaled.y, -(scaled.x * p.x + scaled.y * p.y) / p.z);
    let t = world_from_colour.transform_vector(by_point);
    let r = (position - pivot).cross(t);
    [t.x, t.y, t.z, r.x, r.y, r.z, value, 1.0]
}

/// Tukey's biweight error of a squared residual, and the weight by which it counts in the normal equations (Beaton & Tukey
/// 1974).
pub fn tukey(square: f64, cutoff: f64) -> (f64, f64) {
    let rest = (1.0 - square / (cutoff * cutoff)).max(0.0);
    (cutoff * cutoff / 6.0 * (1.0 - rest.powi(3)), rest * rest)
}

const LUMA: DVec3 = DVec3::new(0.299, 0.587, 0.114);

/// The sums over a list of points against an image whose camera is taken to be at `world_from_colour`.
pub fn photometric(
    list: &[Option<ColouredPoint>],
    image: &ColourImage,
    camera: &Intrinsics,
    world_from_colour: &Se3,
    pivot: DVec3,
    term: &PhotometricTerm,
) -> PhotometricSums {
    let mut sums = PhotometricSums::default();
    let (gain, offset, cutoff) = (f64::from(term.gain), f64::from(term.offset), f64::from(term.cutoff));
    for ColouredPoint { position, colour } in list.iter().flatten() {
        sums.valid += 1;
        let in_camera = world_from_colour.inverse().transform_point(*position);
        let weight = weight_by_depth(term.weight, term.depth_range_m, in_camera.z);
        let seen = camera.project(in_camera).and_then(|pixel| sample(image, pixel));
        let channels = |s: &Sample| {
            if term.rgb {
                let of = |c: usize| (colour[c], s.value[c], DVec2::new(s.along_x[c], s.along_y[c]));
                vec![of(0), of(1), of(2)]
            } else {
                vec![(colour.dot(LUMA), s.value.dot(LUMA), DVec2::new(s.along_x.dot(LUMA), s.along_y.dot(LUMA)))]
            }
        };
        let change = |s: &Sample| channels(s).iter().map(|(.., along)| along.length_squared()).sum::<f64>().sqrt();
        let Some(seen) = seen.filter(|s| change(s) >= f64::from(term.least_gradient)) else {
            sums.unseen += weight;
            continue;
        };
        let channels = channels(&seen);
        let residual = |&(expected, value, _): &(f64, f64, DVec2)| gain * expected + offset - value;
        let square = channels.iter().map(|c| residual(c).powi(2)).sum();
        let (error, robust) = tukey(square, cutoff);
        sums.cost += weight * error;
        sums.weights += weight;
        if robust == 0.0 {
            continue;
        }
        sums.squares += square;
        sums.count += 1;
        for channel in &channels {
            let jacobian = jacobian(*position, pivot, camera, world_from_colour, channel.2, channel.0);
            for (row, a) in jacobian.iter().enumerate() {
                for (column, b) in jacobian.iter().enumerate() {
                    sums.hessian[row][column] += weight * robust * a * b;
                }
                sums.gradient[row] += weight * robust * a * residual(channel);
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A smooth image: intensity a plane wave's, without rounding to bytes.
    fn intensity(pixel: DVec2) -> f64 {
        0.5 + 0.3 * (0.11 * pixel.x + 0.07 * pixel.y).sin()
    }

    fn slope(pixel: DVec2) -> DVec2 {
        0.3 * (0.11 * pixel.x + 0.07 * pixel.y).cos() * DVec2::new(0.11, 0.07)
    }

    fn vector(size: f64) -> impl Strategy<Value = DVec3> {
        [-size..size, -size..size, -size..size].prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn the_jacobian_is_the_residuals_derivative(
            place in vector(0.5), pivot in vector(1.0), twist in prop::array::uniform6(-0.3..0.3f64), value in 0.0..1.0f64,
        ) {
            let camera = Intrinsics::new(64, 48, 60.0, -61.0, 31.0, 23.0);
            let world_from_colour = Se3::exp(twist);
            let position = world_from_colour.transform_point(place + DVec3::new(0.0, 0.0, 1.5));
            let to_pivot = Se3::new(glam::DQuat::IDENTITY, pivot);
            let residual = |step: [f64; 8]| {
                let [x, y, z, a, b, c, gain, offset] = step;
                let moved = to_pivot * Se3::exp([x, y, z, a, b, c]) * to_pivot.inverse() * world_from_colour;
                let pixel = camera.project(moved.inverse().transform_point(position)).unwrap();
                (1.0 + gain) * value + offset - intensity(pixel)
            };
            let pixel = camera.project(world_from_colour.inverse().transform_point(position)).unwrap();
            let found = jacobian(position, pivot, &camera, &world_from_colour, slope(pixel), value);
            for (i, derivative) in found.into_iter().enumerate() {
                let step = |h: f64| {
                    let mut step = [0.0; 8];
                    step[i] = h;
                    residual(step)
                };
                let numeric = (step(1e-5) - step(-1e-5)) / 2e-5;
                prop_assert!((numeric - derivative).abs() < 1e-5 * (1.0 + derivative.abs()), "{i}: {numeric} but {derivative}");
            }
        }

        #[test]
        fn tukeys_weight_is_its_errors_slope(residual in -1.0..1.0f64, cutoff in 0.05..0.8f64) {
            let error = |r: f64| tukey(r * r, cutoff).0;
            let slope = (error(residual + 1e-6) - error(residual - 1e-6)) / 2e-6;
            prop_assert!((tukey(residual * residual, cutoff).1 * residual - slope).abs() < 1e-6);
            prop_assert!(error(residual) <= cutoff * cutoff / 6.0 + 1e-15);
        }
    }

    #[test]
    fn a_sample_is_between_its_four_pixels() {
        let image = ColourImage::from_fn(3, 2, |x, y| [(x * 51) as u8, (y * 51) as u8, 0, 255]);
        let s = sample(&image, DVec2::new(1.25, 0.5)).unwrap();
        assert!(s.value.abs_diff_eq(DVec3::new(0.25, 0.1, 0.0), 1e-12));
        assert!(s.along_x.abs_diff_eq(DVec3::new(0.2, 0.0, 0.0), 1e-12));
        assert!(s.along_y.abs_diff_eq(DVec3::new(0.0, 0.2, 0.0), 1e-12));
        assert!(sample(&image, DVec2::new(2.0, 1.0)).is_some() && sample(&image, DVec2::new(2.01, 1.0)).is_none());
        let holed = ColourImage::from_fn(3, 2, |x, y| [9, 9, 9, if (x, y) == (2, 1) { 0 } else { 255 }]);
        assert!(sample(&holed, DVec2::new(0.5, 0.5)).is_some() && sample(&holed, DVec2::new(1.5, 0.5)).is_none());
    }
}
