//! What meshes and point clouds have in common: vertices with attributes.

use glam::Vec3;
use thiserror::Error;

/// A mesh or a point cloud whose parts do not fit together.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("expected {expected}, found {found}")]
pub struct GeometryError {
    /// What would do.
    pub expected: &'static str,
    /// What there is.
    pub found: String,
}

/// Smallest and largest coordinates, or `None` without positions.
pub(crate) fn bounds(positions: &[Vec3]) -> Option<(Vec3, Vec3)> {
    let first = *positions.first()?;
    Some(positions.iter().fold((first, first), |(lo, hi), p| (lo.min(*p), hi.max(*p))))
}

/// Whether there are none or as many of each attribute (normals, colours, weights, confidences) as vertices, and whether all positions
/// are finite.
pub(crate) fn check_vertices(positions: &[Vec3], counts: [usize; 4]) -> Result<(), GeometryError> {
    let vertices = positions.len();
    for (name, count) in ["normals", "colours", "weights", "confidences"].into_iter().zip(counts) {
        if count != 0 && count != vertices {
            return Err(GeometryError {
                expected: "none or as many normals, colours, weights and confidences as vertices",
                found: format!("{count} {name} for {vertices} vertices"),
            });
        }
    }
    match positions.iter().position(|p| !p.is_finite()) {
        Some(i) => {
            let found = format!("vertex {i} at {}", positions[i]);
            Err(GeometryError { expected: "finite positions", found })
        }
        None => Ok(()),
    }
}
