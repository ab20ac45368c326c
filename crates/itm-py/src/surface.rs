//! Meshes and point clouds.

use std::path::PathBuf;

use glam::Vec3;
use itm_io::mesh::UpAxis;
use numpy::{PyArray1, PyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::{arrays, errors};

fn up_axis(name: Option<&str>) -> PyResult<Option<UpAxis>> {
    match name {
        None => Ok(None),
        Some("y-down") => Ok(Some(UpAxis::YDown)),
        Some("y-up") => Ok(Some(UpAxis::YUp)),
        Some("z-up") => Ok(Some(UpAxis::ZUp)),
        Some(other) => Err(PyValueError::new_err(format!("up must be 'y-down', 'y-up' or 'z-up', not '{other}'"))),
    }
}

fn vectors<'py>(py: Python<'py>, vectors: &[Vec3]) -> PyResult<Bound<'py, PyArray2<f32>>> {
    arrays::rows(py, vectors.iter().map(|v| v.to_array()))
}

/// Bytes of colour as rows; None for none.
fn colours<'py>(py: Python<'py>, colours: &[[u8; 3]]) -> PyResult<Option<Bound<'py, PyArray2<u8>>>> {
    (!colours.is_empty()).then(|| arrays::rows(py, colours.iter().copied())).transpose()
}

/// A triangle mesh in world coordinates (metres); seen from free space, triangles run counter-clockwise. Each access makes new
/// arrays.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct Mesh(pub(crate) itm_core::Mesh);

#[pymethods]
impl Mesh {
    /// Positions in metres, Nx3 float32.
    #[getter]
    fn vertices<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        vectors(py, &self.0.positions)
    }

    /// Vertices of each triangle, Mx3 uint32.
    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        arrays::rows(py, self.0.triangles.iter().copied())
    }

    /// Unit normals that point into free space, Nx3 float32.
    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        vectors(py, &self.0.normals)
    }

    /// Red, green, blue, Nx3 uint8; None where the map holds no colour.
    #[getter]
    fn colours<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<u8>>>> {
        colours(py, &self.0.colours)
    }

    /// How often the surface was observed at each vertex, N uint16; None where unknown.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<u16>>> {
        (!self.0.weights.is_empty()).then(|| arrays::row(py, self.0.weights.clone()))
    }

    /// Writes the mesh as PLY, OBJ, STL or GLB, by the name's ending; up is 'y-down' (as it is), 'y-up' or 'z-up'.
    #[pyo3(signature = (path, up=None))]
    fn save(&self, py: Python<'_>, path: PathBuf, up: Option<&str>) -> PyResult<()> {
        let options = itm_io::mesh::WriteOptions { up: up_axis(up)? };
        let written = py.detach(|| itm_io::mesh::write(&path, &self.0, &options));
        written.map_err(|error| errors::of_io(&error, errors::export))
    }

    /// The triangles that lie within a box, and their vertices.
    fn crop(&self, py: Python<'_>, min: &Bound<'_, PyAny>, max: &Bound<'_, PyAny>) -> PyResult<Self> {
        let (min, max) = (arrays::vector(min, "min")?, arrays::vector(max, "max")?);
        Ok(py.detach(|| Self(self.0.clone().crop(min, max))))
    }

    /// A mesh with this share of the triangles, above 0 and at most 1.
    fn decimate(&self, py: Python<'_>, ratio: f32) -> PyResult<Self> {
        let decimated = py.detach(|| itm_slam::decimate(&self.0, ratio));
        decimated.map(Self).map_err(|error| PyValueError::new_err(error.to_string()))
    }

    /// The mesh without pieces of fewer connected triangles.
    fn without_small_pieces(&self, py: Python<'_>, triangles: usize) -> Self {
        py.detach(|| {
            let mut mesh = self.0.clone();
            let _dropped = mesh.drop_small_components(triangles);
            Self(mesh)
        })
    }

    fn __repr__(&self) -> String {
        format!("<Mesh of {} vertices and {} faces>", self.0.positions.len(), self.0.triangles.len())
    }
}

/// Points of surfaces in world coordinates (metres). Each access makes new arrays.
#[pyclass(module = "itm_slam", frozen)]
pub(crate) struct PointCloud(pub(crate) itm_core::PointCloud);

#[pymethods]
impl PointCloud {
    /// Positions in metres, Nx3 float32.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        vectors(py, &self.0.positions)
    }

    /// Unit normals that point into free space, Nx3 float32; None where unknown.
    #[getter]
    fn normals<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f32>>>> {
        (!self.0.normals.is_empty()).then(|| vectors(py, &self.0.normals)).transpose()
    }

    /// Red, green, blue, Nx3 uint8; None where the map holds no colour.
    #[getter]
    fn colours<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<u8>>>> {
        colours(py, &self.0.colours)
    }

    /// How often each point was observed, N float32; None where unknown.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f32>>> {
        (!self.0.weights.is_empty()).then(|| arrays::row(py, self.0.weights.clone()))
    }

    /// How many of the best observations would tell as much of each point, N float32; None where unknown.
    #[getter]
    fn confidences<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f32>>> {
        (!self.0.confidences.is_empty()).then(|| arrays::row(py, self.0.confidences.clone()))
    }

    /// Writes the points as PLY, PCD or XYZ, by the name's ending; up is 'y-down' (as it is), 'y-up' or 'z-up'.
    #[pyo3(signature = (path, up=None))]
    fn save(&self, py: Python<'_>, path: PathBuf, up: Option<&str>) -> PyResult<()> {
        let up = up_axis(up)?.unwrap_or_default();
        let written = py.detach(|| itm_io::points::write(&path, &self.0, up));
        written.map_err(|error| errors::of_io(&error, errors::export))
    }

    fn __len__(&self) -> usize {
        self.0.positions.len()
    }

    fn __repr__(&self) -> String {
        format!("<PointCloud of {} points>", self.0.positions.len())
    }
}
