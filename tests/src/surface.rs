//! How far a mesh is from a true surface, and how much of the surface it has.

use std::collections::HashMap;

use glam::{DVec2, IVec3, Vec3};
use itm_slam::{Image, Intrinsics, Mesh, Se3};
use itm_synth::{Quality, Scene, Sequence, render};

/// Exact views of a scene: what each frame's camera sees.
#[derive(Debug)]
pub struct Views {
    camera: Intrinsics,
    range_m: [f32; 2],
    frames: Vec<(Se3, Image<f32>)>,
}

impl Views {
    /// The views of a sequence, for depths within a range.
    pub fn new(sequence: &Sequence, range_m: [f32; 2]) -> Self {
        let camera = sequence.spec().camera;
        let frames = (0..sequence.spec().frames)
            .map(|i| sequence.world_from_camera(i))
            .map(|pose| (pose, render(sequence.scene(), &camera, &pose, Quality::Draft).depth))
            .collect();
        Self { camera, range_m, frames }
    }

    /// Whether a frame's camera sees a point: nothing lies before it, and its depth is within the range.
    fn sees(&self, frame: usize, point: Vec3) -> bool {
        let (world_from_camera, depth) = &self.frames[frame];
        let p = world_from_camera.inverse().transform_point(point.as_dvec3());
        let Some(pixel) = self.camera.project(p) else { return false };
        let (x, y) = ((pixel.x + 0.5).floor(), (pixel.y + 0.5).floor());
        if x < 0.0 || y < 0.0 {
            return false;
        }
        let Some(z) = depth.get(x as u32, y as u32) else { return false };
        let [near, far] = self.range_m;
        *z >= near && *z <= far && (f64::from(*z) - p.z).abs() < 0.02
    }

    /// Whether any frame sees a surface point at less than `degrees` from its normal.
    fn sees_within(&self, point: Vec3, normal: Vec3, degrees: f32) -> bool {
        (0..self.frames.len()).any(|i| {
            let ray = (point - self.frames[i].0.translation.as_vec3()).normalize();
            -ray.dot(normal) > degrees.to_radians().cos() && self.sees(i, point)
        })
    }

    /// Points of the true surface, on a raster of every `stride` pixels of each frame, that at least `least` frames see.
    pub fn surface_points(&self, stride: u32, least: usize) -> Vec<Vec3> {
        let mut points = Vec::new();
        for (world_from_camera, depth) in &self.frames {
            for y in (0..self.camera.height).step_by(stride as usize) {
                for x in (0..self.camera.width).step_by(stride as usize) {
                    let z = depth[(x, y)];
                    if z < self.range_m[0] || z > self.range_m[1] {
                        continue;
                    }
                    let p = self.camera.unproject(DVec2::new(x.into(), y.into()), z.into());
                    let point = world_from_camera.transform_point(p).as_vec3();
                    if (0..self.frames.len()).filter(|i| self.sees(*i, point)).count() >= least {
                        points.push(point);
                    }
                }
            }
        }
        points
    }
}

/// Distances of the mesh's vertices from the true surface, sorted: of those with a weight of at least 3 that some frame
/// sees at less than 70 degrees from the normal.
pub fn accuracy_m(mesh: &Mesh, scene: &Scene, views: &Views) -> Vec<f32> {
    let mut distances: Vec<f32> = mesh
        .positions
        .iter()
        .zip(&mesh.normals)
        .zip(&mesh.weights)
        .filter(|((p, n), w)| **w >= 3 && views.sees_within(**p, **n, 70.0))
        .map(|((p, _), _)| scene.distance(*p).abs())
        .collect();
    distances.sort_by(f32::total_cmp);
    distances
}

/// The share of `points` that lie within `reach_m` of the mesh's triangles.
pub fn completeness(mesh: &Mesh, points: &[Vec3], reach_m: f32) -> f64 {
    let cell = |p: Vec3| (p / reach_m).floor().as_ivec3();
    let mut triangles: HashMap<IVec3, Vec<u32>> = HashMap::new();
    for (corners, number) in mesh.triangles.iter().zip(0..) {
        let [a, b, c] = corners.map(|i| mesh.positions[i as usize]);
        let (lo, hi) = (cell(a.min(b).min(c)), cell(a.max(b).max(c)));
        for z in lo.z..=hi.z {
            for y in lo.y..=hi.y {
                for x in lo.x..=hi.x {
                    triangles.entry(IVec3::new(x, y, z)).or_default().push(number);
                }
            }
        }
    }
    let near = |p: &Vec3| {
        let centre = cell(*p);
        (0..27).any(|i| {
            let offset = IVec3::new(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1);
            triangles.get(&(centre + offset)).is_some_and(|list| {
                list.iter().any(|t| {
                    let [a, b, c] = mesh.triangles[*t as usize].map(|i| mesh.positions[i as usize]);
                    closest_on_triangle(*p, a, b, c).distance(*p) <= reach_m
                })
            })
        })
    };
    points.iter().filter(|p| near(p)).count() as f64 / points.len().max(1) as f64
}

/// The point of a triangle nearest to `p`, by the Voronoi regions of its corners and edges (Ericson 2005, *Real-Time
/// Collision Detection*, section 5.1.5).
fn closest_on_triangle(p: Vec3, a: Vec3, b: Vec3, c: Vec3) -> Vec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    a + ab * (vb / sum) + ac * (vc / sum)
}

/// The value below which a share of sorted values lies.
pub fn quantile(sorted: &[f32], share: f64) -> f32 {
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}
