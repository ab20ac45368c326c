//! Reference of stage `mesh_view`: a ray through each pixel, tried on each triangle.

use glam::{DVec2, DVec3};
use itm_core::{ColourImage, Image, Intrinsics, Mesh, Se3};

use super::render::{bytes, lit, on_scale};
use crate::mesh_view::NEAR_M;
use crate::render::{Scale, Shading};

/// Paints a mesh that has normals: colours, and depth along the optical axis in metres, 0 where a ray meets nothing.
pub fn paint(
    mesh: &Mesh,
    camera: &Intrinsics,
    world_from_camera: &Se3,
    far_m: f32,
    shading: Shading,
    scale: &Scale,
) -> (ColourImage, Image<f32>) {
    let camera_from_world = world_from_camera.inverse();
    let corners = |triangle: &[u32; 3]| {
        triangle.map(|v| camera_from_world.transform_point(mesh.positions[v as usize].as_dvec3()))
    };
    let triangles: Vec<[DVec3; 3]> = mesh.triangles.iter().map(corners).collect();
    let mut depths = Image::filled(camera.width, camera.height, 0.0);
    let colours = ColourImage::from_fn(camera.width, camera.height, |x, y| {
        let ray = camera.unproject(DVec2::new(x.into(), y.into()), 1.0);
        let met = triangles.iter().zip(&mesh.triangles).filter_map(|(corners, of)| {
            let (depth, shares) = meet(ray, corners)?;
            (depth >= NEAR_M.into() && depth <= far_m.into()).then_some((depth, shares, of))
        });
        let Some((depth, shares, of)) = met.min_by(|a, b| a.0.total_cmp(&b.0)) else { return [0; 4] };
        depths.data_mut()[(y * camera.width + x) as usize] = depth as f32;
        let mean = |of_vertex: &dyn Fn(usize) -> DVec3| -> DVec3 {
            (0..3).map(|i| shares[i] * of_vertex(of[i] as usize)).sum()
        };
        let normal = mean(&|v| mesh.normals[v].as_dvec3()).normalize_or_zero();
        // The light is at the camera.
        let light = world_from_camera.transform_vector(-ray).normalize();
        bytes(match shading {
            Shading::Normals => 0.5 + 0.5 * normal,
            Shading::Depth => on_scale(depth, scale.depth_m),
            Shading::Colour if !mesh.colours.is_empty() => {
                mean(&|v| DVec3::from_array(mesh.colours[v].map(f64::from))) / 255.0
            }
            Shading::Confidence if !mesh.confidences.is_empty() => {
                on_scale(mean(&|v| DVec3::splat(mesh.confidences[v].into())).x, [0.0, scale.confidence])
            }
            Shading::Confidence if !mesh.weights.is_empty() => {
                on_scale(mean(&|v| DVec3::splat(mesh.weights[v].into())).x, [0.0, scale.confidence])
            }
            Shading::Grey | Shading::Phong | Shading::Colour | Shading::Confidence => lit(shading, normal.dot(light)),
        })
    });
    (colours, depths)
}

/// Where a ray from the origin meets a triangle, as a multiple of the ray, and the shares of its corners in that point.
fn meet(ray: DVec3, &[a, b, c]: &[DVec3; 3]) -> Option<(f64, [f64; 3])> {
    // The ray's multiple is a sum of the corners; each one's share follows by Cramer's rule.
    let parts = [ray.dot(b.cross(c)), ray.dot(c.cross(a)), ray.dot(a.cross(b))];
    let sum: f64 = parts.iter().sum();
    let inside = parts.iter().all(|part| *part >= 0.0) || parts.iter().all(|part| *part <= 0.0);
    (inside && sum != 0.0).then(|| (a.dot(b.cross(c)) / sum, parts.map(|part| part / sum)))
}
