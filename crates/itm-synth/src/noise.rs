//! What a structured-light depth camera makes of exact depth.

use glam::{DVec2, Vec3};
use itm_core::{Image, Intrinsics};
use rand::RngExt;
use rand_pcg::Pcg32;
use rayon::prelude::*;

use crate::random::{Stream, gaussian};

/// Errors of a depth camera.
///
/// In this order: near depth edges a pixel reports what lies a fraction of a pixel beside it, and pixels just behind
/// an edge often report nothing (the projector does not reach there); surfaces seen at grazing angles often report
/// nothing; depth varies along the axis with a standard deviation that grows with distance (Nguyen et al. 2012,
/// *Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking*, equation 3); it is rounded to the
/// sensor's steps of disparity (Khoshelham and Oude Elberink 2012, *Accuracy and Resolution of Kinect Depth Data*,
/// equation 11); and outside of its range the sensor reports nothing. Shifting within the image and rounding the
/// disparity follow Barron and Malik 2013 (*Intrinsic Scene Properties from a Single RGB-D Image*) and Handa et al.
/// 2014 (*A Benchmark for RGB-D Visual Odometry, 3D Reconstruction and SLAM*).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthNoise {
    /// Standard deviation in metres at `axial_from_m`.
    pub axial_sigma_m: f32,
    /// Growth of the standard deviation with the square of the distance from `axial_from_m`, per metre.
    pub axial_growth_per_m: f32,
    /// See `axial_sigma_m`; metres.
    pub axial_from_m: f32,
    /// A step of disparity at depth `z` is this times `z * z`: per metre. 0 switches rounding off.
    pub disparity_step_per_m: f32,
    /// Standard deviation of the shift within the image, in pixels along each axis.
    pub lateral_sigma_px: f64,
    /// Two neighbours are on different sides of a depth edge if their depths differ by more than this share and by
    /// more than the surface's slope explains.
    pub edge_share: f32,
    /// Share of pixels just behind a depth edge that report nothing.
    pub edge_dropout: f32,
    /// Angles between viewing ray and normal, in radians, from which on pixels drop out, and at which all do.
    pub grazing_rad: [f32; 2],
    /// Nearest and farthest depth reported, in metres.
    pub range_m: [f32; 2],
}

impl DepthNoise {
    /// The Kinect of 2010.
    pub const KINECT: Self = Self {
        axial_sigma_m: 0.0012,
        axial_growth_per_m: 0.0019,
        axial_from_m: 0.4,
        disparity_step_per_m: 2.85e-3,
        lateral_sigma_px: 0.5,
        edge_share: 0.03,
        edge_dropout: 0.5,
        grazing_rad: [1.25, 1.5],
        range_m: [0.4, 4.5],
    };

    /// Standard deviation of depth in metres on a surface that faces the camera at depth `z`, rounding included.
    pub fn sigma_m(&self, z: f32) -> f32 {
        self.axial_sigma_m + self.axial_growth_per_m * (z - self.axial_from_m).powi(2)
    }

    /// What the sensor reports of an exact depth image (metres, 0 where nothing is seen) with its normals in camera
    /// coordinates, both of the camera's size; 0 where it reports nothing.
    ///
    /// The same for the same seed and frame, however many threads work on it.
    ///
    /// # Panics
    /// Where the images are not of the camera's size.
    pub fn apply(
        &self,
        depth: &Image<f32>,
        normals: &Image<Vec3>,
        camera: &Intrinsics,
        seed: u64,
        frame: u64,
    ) -> Image<f32> {
        let size = (camera.width, camera.height);
        assert!(depth.size() == size && normals.size() == size, "images of the camera's size");
        let (width, height) = size;
        let seed = Stream::Depth.seed(seed, frame);
        let noisy: Vec<f32> = (0..height)
            .into_par_iter()
            .flat_map_iter(|y| {
                // One sequence a row, so that threads may take rows in any order.
                let mut random = Pcg32::new(seed, u64::from(y));
                (0..width).map(move |x| self.pixel(depth, normals, camera, (x, y), &mut random))
            })
            .collect();
        Image::new(width, height, noisy).expect("one value a pixel")
    }

    fn pixel(
        &self,
        depth: &Image<f32>,
        normals: &Image<Vec3>,
        camera: &Intrinsics,
        (x, y): (u32, u32),
        random: &mut Pcg32,
    ) -> f32 {
        // All are drawn whatever the pixel sees, so that a change in one place leaves the noise elsewhere as it was.
        let shift = DVec2::new(gaussian(random), gaussian(random)) * self.lateral_sigma_px;
        let axial = gaussian(random) as f32;
        let (edge_luck, grazing_luck) = (random.random::<f32>(), random.random::<f32>());

        let beside = |at: u32, by: f64, size: u32| (f64::from(at) + by).round().clamp(0.0, f64::from(size - 1)) as u32;
        let (sx, sy) = (beside(x, shift.x, camera.width), beside(y, shift.y, camera.height));
        let own = depth[(x, y)];
        let (px, py) = if self.is_edge(own, depth[(sx, sy)], normals[(x, y)].z) { (sx, sy) } else { (x, y) };
        let (z, normal) = (depth[(px, py)], normals[(px, py)]);
        if z <= 0.0 {
            return 0.0;
        }

        let neighbours = [(px.wrapping_sub(1), py), (px + 1, py), (px, py.wrapping_sub(1)), (px, py + 1)];
        let behind = neighbours
            .iter()
            .filter_map(|&(nx, ny)| depth.get(nx, ny))
            .any(|&neighbour| neighbour > 0.0 && neighbour < z && self.is_edge(z, neighbour, normal.z));
        if behind && edge_luck < self.edge_dropout {
            return 0.0;
        }

        let ray = camera.unproject(DVec2::new(f64::from(px), f64::from(py)), 1.0).normalize().as_vec3();
        let angle = (-normal.dot(ray)).clamp(-1.0, 1.0).acos();
        let [from, to] = self.grazing_rad;
        if grazing_luck < (angle - from) / (to - from) {
            return 0.0;
        }

        // The measured deviation includes that of rounding, a twelfth of the step squared.
        let step = self.disparity_step_per_m * z * z;
        let sigma = (self.sigma_m(z).powi(2) - step * step / 12.0).max(0.0).sqrt();
        let noisy = z + sigma * axial;
        let [nearest, farthest] = self.range_m;
        if !(nearest..=farthest).contains(&noisy) {
            return 0.0;
        }
        if self.disparity_step_per_m > 0.0 {
            // Steps of 1/z, a tenth of which is nothing but keeps the largest depth finite.
            let steps = (1.0 / (noisy * self.disparity_step_per_m)).round().max(0.1);
            1.0 / (steps * self.disparity_step_per_m)
        } else {
            noisy
        }
    }

    /// Whether two neighbours' depths are too different for one surface with a normal of this z.
    fn is_edge(&self, a: f32, b: f32, normal_z: f32) -> bool {
        if a <= 0.0 || b <= 0.0 {
            return a != b;
        }
        let slope = normal_z.abs().max(0.05);
        (a - b).abs() > self.edge_share * a.min(b) / slope
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Intrinsics = Intrinsics::new(160, 120, 131.0, 131.0, 79.5, 59.5);

    /// A wall that faces the camera.
    fn wall(z: f32) -> (Image<f32>, Image<Vec3>) {
        (Image::filled(160, 120, z), Image::filled(160, 120, -Vec3::Z))
    }

    #[test]
    fn deviations_are_those_measured_on_the_sensor() {
        for z in [0.8, 1.5, 2.5, 3.5] {
            let (depth, normals) = wall(z);
            let noisy = DepthNoise::KINECT.apply(&depth, &normals, &CAMERA, 7, 3);
            let n = noisy.data().len() as f32;
            let mean = noisy.data().iter().sum::<f32>() / n;
            let sigma = (noisy.data().iter().map(|v| (v - mean).powi(2)).sum::<f32>() / n).sqrt();
            let expected = 0.0012 + 0.0019 * (z - 0.4) * (z - 0.4);
            assert!((sigma / expected - 1.0).abs() < 0.06, "at {z} m: {sigma}, not {expected}");
            assert!((mean - z).abs() < 0.1 * expected, "at {z} m the mean is {mean}");
        }
    }

    #[test]
    fn depth_comes_in_steps_of_disparity() {
        let (depth, normals) = wall(3.0);
        let noisy = DepthNoise::KINECT.apply(&depth, &normals, &CAMERA, 7, 3);
        let mut values: Vec<f32> = noisy.data().to_vec();
        values.sort_by(f32::total_cmp);
        values.dedup();
        for pair in values.windows(2) {
            let expected = 2.85e-3 * pair[0] * pair[1];
            let steps = (pair[1] - pair[0]) / expected;
            assert!((steps - steps.round()).abs() < 0.01, "{} to {} is {steps} steps", pair[0], pair[1]);
        }
        let exact =
            DepthNoise { disparity_step_per_m: 0.0, axial_sigma_m: 0.0, axial_growth_per_m: 0.0, ..DepthNoise::KINECT };
        assert_eq!(exact.apply(&depth, &normals, &CAMERA, 7, 3), depth);
    }

    #[test]
    fn edges_grazing_angles_and_range_cost_pixels() {
        let count = |image: &Image<f32>, x: u32| (0..120).filter(|&y| image[(x, y)] == 0.0).count();
        // A near wall on the left, a far one on the right.
        let (_, normals) = wall(1.0);
        let depth = Image::from_fn(160, 120, |x, _| if x < 80 { 1.0 } else { 2.0 });
        let noisy = DepthNoise::KINECT.apply(&depth, &normals, &CAMERA, 1, 0);
        assert_eq!(count(&noisy, 40) + count(&noisy, 120), 0);
        let dropped = count(&noisy, 80);
        assert!((20..80).contains(&dropped), "{dropped} of 120 behind the edge");
        let swapped = (0..120).filter(|&y| noisy[(79, y)] > 1.5).count();
        assert!(swapped > 3, "{swapped} pixels in front of the edge report what is behind it");

        let grazing = Image::filled(160, 120, Vec3::new(0.0, -1.0, -0.02).normalize());
        let (depth, _) = wall(1.0);
        let noisy = DepthNoise::KINECT.apply(&depth, &grazing, &CAMERA, 1, 0);
        let centre: usize = (0..160).filter(|&x| noisy[(x, 60)] == 0.0).count();
        assert_eq!(centre, 160);

        for z in [0.3, 5.0, 0.0] {
            let (depth, normals) = wall(z);
            let noisy = DepthNoise::KINECT.apply(&depth, &normals, &CAMERA, 1, 0);
            assert!(noisy.data().iter().all(|v| *v == 0.0), "nothing is reported at {z} m");
        }
    }

    #[test]
    fn noise_depends_on_seed_and_frame_only() {
        let (depth, normals) = wall(2.0);
        let noisy = |seed, frame| DepthNoise::KINECT.apply(&depth, &normals, &CAMERA, seed, frame);
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(|| noisy(5, 6));
        let four = rayon::ThreadPoolBuilder::new().num_threads(4).build().unwrap().install(|| noisy(5, 6));
        assert_eq!(one, four);
        assert_ne!(one, noisy(5, 7));
        assert_ne!(one, noisy(6, 6));
    }
}
