//! Whether depth alone tells how the camera moves, everywhere along the paths for loop closure and relocalisation.

use glam::{DVec2, DVec3};
use itm_core::Intrinsics;
use itm_synth::{Path, Sequence, Spec, render_depth};

/// What is farther is noise to a Kinect, and beyond the view's default limit, in metres.
const FARTHEST_M: f32 = 4.0;

/// Twenty times `tracker.min_information`, below which a direction counts as hardly determined.
const LEAST: f64 = 0.02;

const PATHS: [Path; 4] = [Path::Corridor, Path::Eight, Path::Rooms, Path::Kidnapped];

type Matrix6 = [[f64; 6]; 6];

/// The mean square change of points' distances from their planes with a motion: a turn in radians about the points' mean,
/// and a shift in metres, as point-to-plane ICP sees it (Chen and Medioni 1992). `None` where nothing is near enough.
fn information(camera: &Intrinsics, sequence: &Sequence, frame: u32) -> Option<Matrix6> {
    let (depth, normals) = render_depth(sequence.scene(), camera, &sequence.world_from_camera(frame));
    let points: Vec<(DVec3, DVec3)> = (0..camera.height)
        .flat_map(|y| (0..camera.width).map(move |x| (x, y)))
        .filter(|&at| depth[at] > 0.0 && depth[at] <= FARTHEST_M)
        .map(|at| {
            let point = camera.unproject(DVec2::new(at.0.into(), at.1.into()), depth[at].into());
            (point, normals[at].as_dvec3())
        })
        .collect();
    let count = points.len() as f64;
    let mean = points.iter().map(|(point, _)| *point).sum::<DVec3>() / count;
    let mut sum = [[0.0; 6]; 6];
    for (point, normal) in &points {
        let turn = (*point - mean).cross(*normal);
        let row = [turn.x, turn.y, turn.z, normal.x, normal.y, normal.z];
        for (sums, a) in sum.iter_mut().zip(row) {
            for (sum, b) in sums.iter_mut().zip(row) {
                *sum += a * b / count;
            }
        }
    }
    (!points.is_empty()).then_some(sum)
}

/// Whether a symmetric matrix less `shift` times the unit matrix is positive definite: whether Cholesky's decomposition
/// exists.
fn is_above(matrix: &Matrix6, shift: f64) -> bool {
    let mut lower = [[0.0; 6]; 6];
    for i in 0..6 {
        for j in 0..=i {
            let sum: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
            let rest = matrix[i][j] - if i == j { shift } else { 0.0 } - sum;
            if i != j {
                lower[i][j] = rest / lower[j][j];
            } else if rest <= 0.0 {
                return false;
            } else {
                lower[i][i] = rest.sqrt();
            }
        }
    }
    true
}

fn smallest_eigenvalue(matrix: &Matrix6) -> f64 {
    let (mut below, mut above) = (0.0, 10.0);
    for _ in 0..40 {
        let middle = 0.5 * (below + above);
        *(if is_above(matrix, middle) { &mut below } else { &mut above }) = middle;
    }
    below
}

#[test]
fn depth_determines_every_motion() {
    for path in PATHS {
        let spec = Spec::new(path).with_size(64, 48);
        let sequence = Sequence::new(spec).unwrap();
        let uncovered = (0..spec.frames).step_by(15).filter(|&frame| sequence.covered_share(frame) == 0.0);
        let weak: Vec<_> = uncovered
            .map(|frame| {
                (frame, information(&spec.camera, &sequence, frame).map_or(0.0, |matrix| smallest_eigenvalue(&matrix)))
            })
            .filter(|(_, found)| *found < LEAST)
            .collect();
        assert!(weak.is_empty(), "{path}: {weak:?}");
    }
}

#[test]
fn a_bare_wall_leaves_motions_undetermined() {
    let spec = Spec::new(Path::Wall).with_size(64, 48);
    let sequence = Sequence::new(spec).unwrap();
    let matrix = information(&spec.camera, &sequence, spec.frames / 2).unwrap();
    assert!(smallest_eigenvalue(&matrix) < 1e-9);
    assert!(
        smallest_eigenvalue(&std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))))) > 0.999
    );
}

#[test]
fn walls_close_the_view_and_most_of_it_is_within_reach() {
    for path in PATHS {
        let spec = Spec::new(path).with_size(32, 24);
        let sequence = Sequence::new(spec).unwrap();
        for frame in (0..spec.frames).step_by(15) {
            let (depth, _) = render_depth(sequence.scene(), &spec.camera, &sequence.world_from_camera(frame));
            let nearest = depth.data().iter().copied().fold(f32::INFINITY, f32::min);
            assert!(nearest > 0.4, "{path}: {nearest} m at frame {frame}");
            let near = depth.data().iter().filter(|z| **z <= FARTHEST_M).count();
            assert!(near * 2 > depth.data().len(), "{path}: {near} pixels within reach at frame {frame}");
        }
    }
}
