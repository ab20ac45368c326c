//! Stage `mesh_view`: pictures of a triangle mesh, rasterised.

use glam::DVec3;
use itm_core::{Intrinsics, Mesh, Se3};
use itm_shaders::mesh_view::{Bindings, PASS, Params};

use crate::pipeline::RasterPipeline;
use crate::render::{Scale, Shading};
use crate::{Canvas, Device, Error, Recorder};

/// What lies nearer to the camera is not shown, in metres.
pub const NEAR_M: f32 = 0.01;

/// Bytes of a vertex, and of a triangle, on the device.
const VERTEX_BYTES: u64 = 32;
const TRIANGLE_BYTES: u64 = 12;

/// A mesh on the device, to be looked at.
#[derive(Debug)]
pub struct MeshView {
    device: Device,
    pipeline: RasterPipeline,
    parts: Vec<Part>,
    has_colours: bool,
    has_confidences: bool,
}

/// As much of a mesh as fits into the device's buffers: vertices as `mesh_view.wgsl` describes them, and triangles of them.
#[derive(Debug)]
struct Part {
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
}

impl MeshView {
    /// Takes a mesh to the device. Normals that it lacks are computed.
    ///
    /// # Errors
    /// Where the mesh's parts do not fit together ([`Mesh::check`]), or the device has no memory left for it.
    pub fn new(device: &Device, mesh: &Mesh) -> Result<Self, Error> {
        mesh.check().map_err(|reason| Error::Mesh { reason })?;
        let mut with_normals = Mesh::default();
        let normals = if mesh.normals.is_empty() {
            with_normals.positions.clone_from(&mesh.positions);
            with_normals.triangles.clone_from(&mesh.triangles);
            with_normals.compute_normals();
            &with_normals.normals
        } else {
            &mesh.normals
        };
        let record = |&v: &u32| {
            let i = v as usize;
            let [x, y, z] = mesh.positions[i].to_array().map(f32::to_bits);
            let [nx, ny, nz] = normals[i].to_array().map(f32::to_bits);
            let [r, g, b] = mesh.colours.get(i).copied().unwrap_or_default();
            let weight = || mesh.weights.get(i).map_or(0.0, |&weight| weight.into());
            let confidence = mesh.confidences.get(i).copied().unwrap_or_else(weight);
            [x, y, z, u32::from_le_bytes([r, g, b, 255]), nx, ny, nz, confidence.to_bits()]
        };
        let mut parts = Vec::new();
        let largest = device.capabilities().max_binding_bytes;
        split(mesh, largest / VERTEX_BYTES, largest / TRIANGLE_BYTES, |vertices, triangles| {
            let records: Vec<[u32; 8]> = vertices.iter().map(record).collect();
            parts.push(Part::new(device, &records, triangles));
        });
        device.check()?;
        Ok(Self {
            device: device.clone(),
            pipeline: RasterPipeline::new(device, &PASS, &Canvas::TARGETS),
            parts,
            has_colours: !mesh.colours.is_empty(),
            has_confidences: !(mesh.confidences.is_empty() && mesh.weights.is_empty()),
        })
    }

    /// Records that the mesh is painted onto a canvas of the camera's size, in place of what was painted there. Pixels that
    /// show nothing have alpha 0.
    ///
    /// Both sides of triangles are shown, and lit as if they faced the camera; [`Shading::Normals`] shows the mesh's normals
    /// as they are. [`Shading::Confidence`] shows the mesh's confidences, or else its weights. That and [`Shading::Colour`]
    /// are as [`Shading::Grey`] of a mesh that has none. What is nearer than [`NEAR_M`] or farther than `far_m` along the
    /// optical axis is cut away.
    ///
    /// # Panics
    /// If the canvas has another size.
    #[expect(clippy::too_many_arguments, reason = "a view's parameters, as the other stages take them")]
    pub fn paint(
        &self,
        recorder: &mut Recorder,
        camera: &Intrinsics,
        world_from_camera: &Se3,
        far_m: f32,
        shading: Shading,
        scale: &Scale,
        canvas: &Canvas,
    ) {
        assert_eq!((camera.width, camera.height), canvas.size(), "a canvas for another camera");
        let shading = match shading {
            Shading::Colour if !self.has_colours => Shading::Grey,
            Shading::Confidence if !self.has_confidences => Shading::Grey,
            other => other,
        };
        let (kind, range) = shading.kind_and_range(scale);
        let row = |axis: DVec3| (world_from_camera.rotation * axis).as_vec3().extend(0.0).to_array();
        let params = Params {
            turn_x: row(DVec3::X),
            turn_y: row(DVec3::Y),
            turn_z: row(DVec3::Z),
            camera: world_from_camera.translation.as_vec3().extend(1.0).to_array(),
            focal: [camera.fx as f32, camera.fy as f32],
            // The upper left pixel's centre is half a pixel from the corner.
            centre: [(camera.cx + 0.5) as f32, (camera.cy + 0.5) as f32],
            size: [camera.width as f32, camera.height as f32],
            depth_range: [NEAR_M, far_m.clamp(2.0 * NEAR_M, f32::MAX)],
            range,
            kind,
            unused: 0,
        };
        recorder.stage("mesh_view");
        let lists: Vec<_> =
            self.parts.iter().map(|part| (Bindings { params, vertices: &part.vertices }, &part.indices)).collect();
        canvas.rasterise(&self.device, recorder, &self.pipeline, &lists);
    }
}

impl Part {
    fn new(device: &Device, vertices: &[[u32; 8]], triangles: &[[u32; 3]]) -> Self {
        let part = Self {
            vertices: device.storage("vertices of mesh", vertices.len() as u64 * VERTEX_BYTES),
            indices: device.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("triangles of mesh"),
                size: triangles.len() as u64 * TRIANGLE_BYTES,
                usage: wgpu::BufferUsages::INDEX | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }),
        };
        device.queue.write_buffer(&part.vertices, 0, bytemuck::cast_slice(vertices));
        device.queue.write_buffer(&part.indices, 0, bytemuck::cast_slice(triangles));
        part
    }
}

/// Calls `each` with parts of a mesh that hold no more than so many vertices and triangles: the mesh's vertices that the part
/// uses, and its triangles, whose indices count these.
fn split(mesh: &Mesh, max_vertices: u64, max_triangles: u64, mut each: impl FnMut(&[u32], &[[u32; 3]])) {
    const NOT_YET: u32 = u32::MAX;
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    let mut place = vec![NOT_YET; mesh.positions.len()];
    for triangle in &mesh.triangles {
        if vertices.len() as u64 + 3 > max_vertices || triangles.len() as u64 == max_triangles {
            each(&vertices, &triangles);
            vertices.drain(..).for_each(|v: u32| place[v as usize] = NOT_YET);
            triangles.clear();
        }
        triangles.push(triangle.map(|v| {
            let place = &mut place[v as usize];
            if *place == NOT_YET {
                *place = vertices.len() as u32;
                vertices.push(v);
            }
            *place
        }));
    }
    if !triangles.is_empty() {
        each(&vertices, &triangles);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_hold_all_triangles_and_no_more_than_fits() {
        let triangles: Vec<_> = (0..40).map(|i| [i, i + 1, (7 * i) % 42]).collect();
        let mesh = Mesh { positions: vec![glam::Vec3::ZERO; 42], triangles, ..Mesh::default() };
        for (max_vertices, max_triangles, parts) in [(1000, 1000, 1), (3, 1000, 40), (1000, 7, 6), (6, 2, 20)] {
            let (mut found, mut count) = (Vec::new(), 0);
            split(&mesh, max_vertices, max_triangles, |vertices, triangles| {
                assert!(vertices.len() as u64 <= max_vertices && triangles.len() as u64 <= max_triangles);
                found.extend(triangles.iter().map(|t| t.map(|v| vertices[v as usize])));
                count += 1;
            });
            assert_eq!(found, mesh.triangles);
            assert!(count <= parts, "{count} parts of {max_vertices} vertices and {max_triangles} triangles");
        }
        split(&Mesh::default(), 3, 1, |_, _| panic!("nothing to show"));
    }
}
