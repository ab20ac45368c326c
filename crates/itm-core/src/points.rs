//! Point clouds.

use glam::Vec3;

use crate::Mesh;
use crate::geometry::{self, GeometryError};

/// Points of surfaces in world coordinates (metres).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// Positions in metres.
    pub positions: Vec<Vec3>,
    /// Unit normals, one a point, pointing into free space; empty where unknown.
    pub normals: Vec<Vec3>,
    /// Red, green, blue, one a point; empty where the map holds no colour.
    pub colours: Vec<[u8; 3]>,
    /// Integration weight (number of observations), one a point; empty where unknown.
    pub weights: Vec<f32>,
    /// How many of the sensor's best observations would tell as much of a point, one a point; empty where unknown.
    pub confidences: Vec<f32>,
}

impl PointCloud {
    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Smallest and largest coordinates, or `None` without points.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        geometry::bounds(&self.positions)
    }

    /// Whether the cloud's parts fit together.
    ///
    /// # Errors
    /// Attributes that are neither none nor as many as points, or a position, normal, weight or confidence that is not
    /// finite.
    pub fn check(&self) -> Result<(), GeometryError> {
        let counts = [self.normals.len(), self.colours.len(), self.weights.len(), self.confidences.len()];
        geometry::check_vertices(&self.positions, counts)?;
        if let Some(i) = self.normals.iter().position(|n| !n.is_finite()) {
            let found = format!("vertex {i} with the normal {}", self.normals[i]);
            return Err(GeometryError { expected: "finite normals", found });
        }
        if let Some(i) = self.weights.iter().position(|w| !w.is_finite()) {
            let found = format!("vertex {i} with the weight {}", self.weights[i]);
            return Err(GeometryError { expected: "finite weights", found });
        }
        if let Some(i) = self.confidences.iter().position(|c| !c.is_finite()) {
            let found = format!("vertex {i} with the confidence {}", self.confidences[i]);
            return Err(GeometryError { expected: "finite confidences", found });
        }
        Ok(())
    }
}

/// A mesh's vertices, in their order, those that no triangle uses included.
impl From<Mesh> for PointCloud {
    fn from(mesh: Mesh) -> Self {
        Self {
            positions: mesh.positions,
            normals: mesh.normals,
            colours: mesh.colours,
            weights: mesh.weights.into_iter().map(f32::from).collect(),
            confidences: mesh.confidences,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mesh() -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, -2.0, 3.0)],
            normals: vec![Vec3::Z; 3],
            colours: vec![[1, 2, 3], [4, 5, 6], [7, 8, 9]],
            weights: vec![0, 300, u16::MAX],
            confidences: vec![0.0, 1.5, 20.0],
            triangles: vec![[0, 1, 2]],
        }
    }

    #[test]
    fn a_mesh_gives_its_vertices() {
        let cloud = PointCloud::from(mesh());
        assert_eq!((&cloud.positions, &cloud.normals), (&mesh().positions, &mesh().normals));
        assert_eq!((&cloud.colours, &cloud.weights[..]), (&mesh().colours, &[0.0, 300.0, 65535.0][..]));
        assert_eq!(cloud.confidences, mesh().confidences);
        assert_eq!(cloud.bounds(), Some((Vec3::new(0.0, -2.0, 0.0), Vec3::new(1.0, 0.0, 3.0))));
        assert!(cloud.check().is_ok() && !cloud.is_empty());
        assert!(PointCloud::from(Mesh::default()).is_empty());
    }

    #[test]
    fn parts_that_do_not_fit_are_named() {
        let cloud = || PointCloud::from(mesh());
        let refused = |cloud: PointCloud| cloud.check().unwrap_err().to_string();
        let error = refused(PointCloud { weights: vec![1.0; 2], ..cloud() });
        assert!(error.contains("found 2 weights for 3 vertices"), "{error}");
        let error = refused(PointCloud { weights: vec![1.0, f32::INFINITY, 0.0], ..cloud() });
        assert!(error.contains("vertex 1 with the weight inf"), "{error}");
        let error = refused(PointCloud { confidences: vec![1.0, 2.0, f32::NAN], ..cloud() });
        assert!(error.contains("vertex 2 with the confidence NaN"), "{error}");
        let error = refused(PointCloud { normals: vec![Vec3::X, Vec3::X, Vec3::NAN], ..cloud() });
        assert!(error.contains("vertex 2 with the normal"), "{error}");
        let error = refused(PointCloud { positions: vec![Vec3::NAN; 3], ..cloud() });
        assert!(error.contains("vertex 0 at"), "{error}");
    }
}
