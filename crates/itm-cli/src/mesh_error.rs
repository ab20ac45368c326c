//! How far a reconstructed surface is from the true one, where a recording is synthetic and its scene therefore known.

use std::path::Path;

use glam::DQuat;
use itm_core::{Mesh, Se3, Trajectory, evaluation};
use itm_synth::{Scene, SceneName};
use rayon::prelude::*;
use serde::Serialize;

/// The file in a recording's folder that names its scene.
const SCENE_FILE: &str = "synthetic_scene.txt";
/// Vertices seen less often are left out, as they are where meshes are compared.
const LEAST_WEIGHT: u16 = 3;

/// Writes the name of the scene into a recording's folder.
pub(crate) fn mark_scene(folder: &Path, scene: SceneName) -> std::io::Result<()> {
    std::fs::write(folder.join(SCENE_FILE), format!("{scene}\n"))
}

/// The scene that a recording shows, where it is a synthetic one.
pub(crate) fn scene_of(folder: &Path) -> Option<Scene> {
    let name = std::fs::read_to_string(folder.join(SCENE_FILE)).ok()?;
    match name.trim().parse::<SceneName>() {
        Ok(name) => Some(name.scene()),
        Err(error) => {
            tracing::warn!("'{}': {error}, so the mesh is not measured", folder.join(SCENE_FILE).display());
            None
        }
    }
}

/// Distances of a mesh's vertices to the true surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct MeshError {
    /// Vertices measured: those observed at least three times.
    pub(crate) vertices: usize,
    /// Half of them are nearer, in millimetres.
    pub(crate) median_mm: f64,
    /// 99 of 100 are nearer, in millimetres.
    pub(crate) percentile_99_mm: f64,
    /// Share that is nearer than one voxel.
    pub(crate) within_voxel: f64,
}

impl MeshError {
    /// Measures a mesh whose world `truth_from_mesh` takes to the scene's; `None` without vertices to measure.
    pub(crate) fn measure(mesh: &Mesh, scene: &Scene, truth_from_mesh: &Se3, voxel_size_m: f32) -> Option<Self> {
        let observed = |i: usize| mesh.weights.get(i).is_none_or(|&weight| weight >= LEAST_WEIGHT);
        let to_truth = truth_from_mesh.to_mat4();
        let mut distances: Vec<f32> = mesh
            .positions
            .par_iter()
            .enumerate()
            .filter(|(i, _)| observed(*i))
            .map(|(_, p)| scene.distance(to_truth.transform_point3(*p)).abs())
            .collect();
        distances.par_sort_unstable_by(f32::total_cmp);
        let at = |share: f64| distances.get(((distances.len() - 1) as f64 * share).round() as usize);
        let first_beyond = distances.partition_point(|d| *d <= voxel_size_m);
        (!distances.is_empty()).then_some(())?;
        Some(Self {
            vertices: distances.len(),
            median_mm: f64::from(*at(0.5)?) * 1e3,
            percentile_99_mm: f64::from(*at(0.99)?) * 1e3,
            within_voxel: first_beyond as f64 / distances.len() as f64,
        })
    }
}

/// The motion that takes the estimate's world nearest to the truth's, by orientations and positions of the poses.
///
/// The alignment behind an ATE knows positions only: along a path that is nearly a line it may turn about that line,
/// which moves surfaces to the side by far more than the trajectory. Rotations are averaged as quaternions (Markley et
/// al. 2007, *Averaging Quaternions*), which nearly equal ones allow.
pub(crate) fn align_poses(estimate: &Trajectory, truth: &Trajectory) -> Option<Se3> {
    let pairs = evaluation::associate(estimate, truth, evaluation::DEFAULT_TOLERANCE_NS);
    let motions: Vec<Se3> = pairs.iter().map(|(e, t)| t.world_from_camera * e.world_from_camera.inverse()).collect();
    let first = motions.first()?.rotation;
    let near_first = |q: DQuat| if q.dot(first) < 0.0 { -q } else { q };
    let sum = motions.iter().fold(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), |sum, m| sum + near_first(m.rotation));
    let rotation = sum.normalize();
    let offsets =
        pairs.iter().map(|(e, t)| t.world_from_camera.translation - rotation * e.world_from_camera.translation);
    let translation = offsets.sum::<glam::DVec3>() / pairs.len() as f64;
    Some(Se3 { rotation, translation }).filter(Se3::is_finite)
}

#[cfg(test)]
mod tests {
    use super::*;
    use itm_core::{StampedPose, Timestamp};

    #[test]
    fn a_true_surface_that_was_moved_has_no_error_after_the_motion_back() {
        let scene = Scene::room();
        let truth_from_mesh = Se3::exp([0.3, -0.2, 1.0, 0.1, 0.7, -0.4]);
        let mut mesh = itm_synth::exact_mesh(&scene, 0.2).unwrap();
        let back = truth_from_mesh.inverse().to_mat4();
        mesh.positions.iter_mut().for_each(|p| *p = back.transform_point3(*p));
        let error = MeshError::measure(&mesh, &scene, &truth_from_mesh, 0.005).unwrap();
        assert!(error.percentile_99_mm < 0.05 && error.within_voxel == 1.0, "{error:?}");
        assert_eq!(error.vertices, mesh.positions.len());
        // Left where it is, it is off by as much as it was moved.
        let moved = MeshError::measure(&mesh, &scene, &Se3::IDENTITY, 0.005).unwrap();
        assert!(moved.median_mm > 50.0, "{moved:?}");
    }

    #[test]
    fn every_scene_is_found_again_by_its_name() {
        let folder = tempfile::tempdir().unwrap();
        assert!(scene_of(folder.path()).is_none());
        for name in SceneName::ALL {
            mark_scene(folder.path(), name).unwrap();
            let (found, expected) = (scene_of(folder.path()).unwrap(), name.scene());
            assert_eq!((found.bounds(), found.objects()), (expected.bounds(), expected.objects()));
        }
        std::fs::write(folder.path().join(SCENE_FILE), "garden\n").unwrap();
        assert!(scene_of(folder.path()).is_none());
    }

    #[test]
    fn vertices_hardly_seen_are_left_out() {
        let scene = Scene::room();
        let mut mesh = itm_synth::exact_mesh(&scene, 0.5).unwrap();
        mesh.weights = vec![2; mesh.positions.len()];
        assert_eq!(MeshError::measure(&mesh, &scene, &Se3::IDENTITY, 0.005), None);
        mesh.weights[0] = 3;
        assert_eq!(MeshError::measure(&mesh, &scene, &Se3::IDENTITY, 0.005).unwrap().vertices, 1);
    }

    #[test]
    fn poses_on_a_line_align_by_their_orientations() {
        let truth_from_estimate = Se3::exp([1.0, 2.0, 3.0, 0.5, -0.5, 2.5]);
        let on_a_line = |i: i64| Se3::exp([0.1 * i as f64, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let stamped = |i: i64, pose| StampedPose { timestamp: Timestamp(i * 33_000_000), world_from_camera: pose };
        let estimate: Trajectory = (0..9).map(|i| stamped(i, on_a_line(i))).collect();
        let truth: Trajectory = (0..9).map(|i| stamped(i, truth_from_estimate * on_a_line(i))).collect();
        let found = align_poses(&estimate, &truth).unwrap();
        assert!((found.inverse() * truth_from_estimate).log().iter().all(|v| v.abs() < 1e-9), "{found:?}");
        assert_eq!(align_poses(&Trajectory::default(), &truth), None);
    }
}
