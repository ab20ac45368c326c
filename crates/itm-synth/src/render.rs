//! What a camera sees of a scene.

use glam::{DVec2, Vec3};
use itm_core::{ColourImage, Image, Intrinsics, Se3};
use rayon::prelude::*;

use crate::Scene;
use crate::texture::to_srgb;

/// How much work goes into colours. Depth is the same in both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// One ray a pixel and no shadows: for tests.
    Draft,
    /// Four rays a pixel, shadows, and darker corners.
    Fine,
}

/// What a camera sees: images of the camera's size.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendering {
    /// Metres along the optical axis to what the middle of each pixel sees, good to 0.1 mm; 0 where it sees nothing.
    pub depth: Image<f32>,
    /// Unit surface normals in camera coordinates, towards the camera; zero where it sees nothing.
    pub normals: Image<Vec3>,
    /// Colour as sRGB bytes, 255 in the fourth. A point has the same colour from wherever it is seen.
    pub colour: ColourImage,
}

/// Farthest that rays are followed, in metres.
const FAR_M: f32 = 40.0;

/// Renders a scene as seen by a pinhole camera, by sphere tracing (Hart 1996, *Sphere Tracing: A Geometric Method for
/// the Antialiased Ray Tracing of Implicit Surfaces*).
///
/// The result does not depend on the number of threads.
pub fn render(scene: &Scene, camera: &Intrinsics, world_from_camera: &Se3, quality: Quality) -> Rendering {
    let view = View { scene, camera, world_from_camera };
    let hits = view.hits();
    let (depth, normals) = view.geometry(&hits);
    Rendering { depth, normals, colour: view.colours(&hits, quality) }
}

/// Depth and normals of [`render`] alone, which take a fraction of the time.
pub fn render_depth(scene: &Scene, camera: &Intrinsics, world_from_camera: &Se3) -> (Image<f32>, Image<Vec3>) {
    let view = View { scene, camera, world_from_camera };
    view.geometry(&view.hits())
}

/// Colour of [`render`] alone.
pub(crate) fn render_colour(
    scene: &Scene,
    camera: &Intrinsics,
    world_from_camera: &Se3,
    quality: Quality,
) -> ColourImage {
    let view = View { scene, camera, world_from_camera };
    view.colours(&view.hits(), quality)
}

/// A point where a ray meets a surface.
#[derive(Clone, Copy)]
struct Hit {
    /// Along the optical axis, in metres.
    z: f32,
    /// In the world.
    point: Vec3,
    /// Of unit length, in the world.
    normal: Vec3,
    object: usize,
}

#[derive(Clone, Copy)]
struct View<'a> {
    scene: &'a Scene,
    camera: &'a Intrinsics,
    world_from_camera: &'a Se3,
}

impl View<'_> {
    /// What the middle of each pixel sees.
    fn hits(&self) -> Image<Option<Hit>> {
        let (width, height) = (self.camera.width, self.camera.height);
        let hits: Vec<Option<Hit>> = (0..height)
            .into_par_iter()
            .flat_map_iter(|y| (0..width).map(move |x| self.trace(f64::from(x), f64::from(y))))
            .collect();
        Image::new(width, height, hits).expect("one hit a pixel")
    }

    /// Depth, and normals in camera coordinates.
    fn geometry(&self, hits: &Image<Option<Hit>>) -> (Image<f32>, Image<Vec3>) {
        let (width, height) = hits.size();
        let camera_from_world = self.world_from_camera.rotation.conjugate().as_quat();
        (
            Image::from_fn(width, height, |x, y| hits[(x, y)].map_or(0.0, |hit| hit.z)),
            Image::from_fn(width, height, |x, y| hits[(x, y)].map_or(Vec3::ZERO, |hit| camera_from_world * hit.normal)),
        )
    }

    fn colours(&self, hits: &Image<Option<Hit>>, quality: Quality) -> ColourImage {
        let (width, height) = hits.size();
        let colours: Vec<[u8; 4]> = (0..height)
            .into_par_iter()
            .flat_map_iter(|y| {
                (0..width).map(move |x| {
                    let linear = match quality {
                        Quality::Draft => hits[(x, y)].map_or(Vec3::ZERO, |hit| self.draft_colour(&hit)),
                        Quality::Fine => self.fine_colour(hits, x, y),
                    };
                    let [r, g, b] = expose(linear);
                    [r, g, b, 255]
                })
            })
            .collect();
        Image::new(width, height, colours).expect("one colour a pixel")
    }

    /// Direction of unit length in the world that a place in the image looks in, and how far one metre along it goes
    /// along the optical axis.
    fn direction(&self, x: f64, y: f64) -> (Vec3, f32) {
        let direction = self.camera.unproject(DVec2::new(x, y), 1.0).normalize();
        (self.world_from_camera.transform_vector(direction).as_vec3(), direction.z as f32)
    }

    fn trace(&self, x: f64, y: f64) -> Option<Hit> {
        let (direction, z_per_m) = self.direction(x, y);
        let origin = self.world_from_camera.translation.as_vec3();
        let (t, object) = march(self.scene, origin, direction)?;
        let point = origin + t * direction;
        let normal = self.scene.objects()[object].normal(point);
        Some(Hit { z: t * z_per_m, point, normal, object })
    }

    fn albedo(&self, hit: &Hit) -> Vec3 {
        self.scene.objects()[hit.object].albedo(hit.point, hit.normal)
    }

    fn draft_colour(&self, hit: &Hit) -> Vec3 {
        self.albedo(hit) * (light(self.scene, hit.point, hit.normal, false) + self.scene.objects()[hit.object].glow())
    }

    /// The mean of four places in a pixel. Where the pixel and its neighbours lie on one smooth surface, only the
    /// pattern is looked up four times, on the plane that touches the surface.
    fn fine_colour(&self, hits: &Image<Option<Hit>>, x: u32, y: u32) -> Vec3 {
        const OFFSETS: [(f64, f64); 4] = [(-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125)];
        let centre = hits[(x, y)];
        let on_one_surface = |a: &Hit, b: &Hit| {
            a.object == b.object
                && a.normal.dot(b.normal) > 0.95
                && (b.point - a.point).dot(a.normal).abs() < 0.2 * b.point.distance(a.point) + 1e-4
        };
        let neighbours = [(x.wrapping_sub(1), y), (x + 1, y), (x, y.wrapping_sub(1)), (x, y + 1)];
        let smooth = centre.as_ref().filter(|hit| {
            neighbours.iter().all(|&(nx, ny)| match hits.get(nx, ny) {
                None => true,
                Some(neighbour) => neighbour.as_ref().is_some_and(|n| on_one_surface(hit, n)),
            })
        });
        let places = OFFSETS.map(|(dx, dy)| (f64::from(x) + dx, f64::from(y) + dy));
        let sum: Vec3 = if let Some(hit) = smooth {
            let origin = self.world_from_camera.translation.as_vec3();
            let albedo: Vec3 = places
                .iter()
                .map(|&(x, y)| {
                    let (direction, _) = self.direction(x, y);
                    let t = hit.normal.dot(hit.point - origin) / hit.normal.dot(direction);
                    let point = if t.is_finite() { origin + t * direction } else { hit.point };
                    self.albedo(&Hit { point, ..*hit })
                })
                .sum();
            albedo * (light(self.scene, hit.point, hit.normal, true) + self.scene.objects()[hit.object].glow())
        } else {
            // Light changes little within a pixel unless the surface does.
            let mut known: Option<(Hit, Vec3)> = None;
            let mut sum = Vec3::ZERO;
            for hit in places.iter().filter_map(|&(x, y)| self.trace(x, y)) {
                let light = match known {
                    Some((other, light)) if other.object == hit.object && other.normal.dot(hit.normal) > 0.95 => light,
                    _ => light(self.scene, hit.point, hit.normal, true) + self.scene.objects()[hit.object].glow(),
                };
                known = Some((hit, light));
                sum += self.albedo(&hit) * light;
            }
            sum
        };
        sum / 4.0
    }
}

/// How far a ray goes before it meets a surface, and which object's.
fn march(scene: &Scene, origin: Vec3, direction: Vec3) -> Option<(f32, usize)> {
    // Steps are as long as nothing can be nearer. Close to a surface they get short, more so the flatter the ray; there
    // the secant through the last two distances takes over. It is exact for planes, and taken only where it leads to a
    // smaller distance.
    const NEAR: f32 = 1e-3;
    const DONE: f32 = 2e-6;
    let (mut t, mut last_t, mut last_d) = (0.0f32, 0.0f32, f32::INFINITY);
    for _ in 0..400 {
        let (d, object) = scene.nearest(origin + t * direction);
        if d < DONE {
            return Some((t, object));
        }
        let slope = (last_d - d) / (t - last_t);
        if d < NEAR && slope > 1e-3 && t > last_t {
            let jump = t + d / slope;
            let (at_jump, hit) = scene.nearest(origin + jump * direction);
            if at_jump.abs() < DONE.max(1e-6 * jump) {
                return Some((jump, hit));
            }
        }
        (last_t, last_d) = (t, d);
        t += d;
        // A step below the spacing of the numbers goes nowhere: this is as near as they can say.
        if t == last_t {
            return Some((t, object));
        }
        if t > FAR_M {
            return None;
        }
    }
    // Grazing along a surface for so long is as good as touching it, if it is near.
    let (d, object) = scene.nearest(origin + t * direction);
    (d < NEAR).then_some((t, object))
}

/// Light that arrives at a surface: an even glow, a little more from above, and the scene's lamps after Lambert.
fn light(scene: &Scene, point: Vec3, normal: Vec3, shadows: bool) -> Vec3 {
    let lamps = scene.lamps();
    // Without lamps the glow alone has to tell the sides of a box apart.
    let strength = if lamps.is_empty() { 0.75 } else { 0.42 };
    let ambient = strength * (1.0 + 0.18 * -normal.y + 0.10 * normal.x - 0.06 * normal.z);
    let open = if shadows { openness(scene, point, normal) } else { 1.0 };
    let mut sum = Vec3::splat(ambient * open);
    for lamp in lamps {
        let offset = lamp.position - point;
        let distance = offset.length();
        let facing = normal.dot(offset) / distance;
        let most = lamp.power * (facing / (0.4 + distance * distance));
        // What would not be seen needs no shadow.
        if facing > 0.0 && most.max_element() > 0.01 {
            let reached =
                if shadows { unshadowed(scene, point + 2e-3 * normal, offset / distance, distance) } else { 1.0 };
            sum += most * reached;
        }
    }
    sum
}

/// Share of the surroundings' light that reaches a point: less in corners, where surfaces are nearer to points above
/// the surface than the surface itself is.
fn openness(scene: &Scene, point: Vec3, normal: Vec3) -> f32 {
    let (mut blocked, mut weight) = (0.0, 1.0);
    for height in [0.02, 0.06, 0.14, 0.28] {
        blocked += weight * (1.0 - scene.distance(point + height * normal) / height).max(0.0);
        weight *= 0.7;
    }
    1.0 - 0.3 * blocked
}

/// Share of a lamp that is seen from a point, between 0 and 1: the less, the closer surfaces come to the way there,
/// as if the lamp had some size.
fn unshadowed(scene: &Scene, point: Vec3, direction: Vec3, distance: f32) -> f32 {
    // The lamp's own shade or bulb must not hide it.
    let end = distance - 0.3;
    let (mut t, mut seen) = (0.01f32, 1.0f32);
    for _ in 0..48 {
        if t >= end {
            break;
        }
        let d = scene.distance(point + t * direction);
        seen = seen.min(12.0 * d / t);
        if seen < 0.02 {
            return 0.0;
        }
        t += d.clamp(0.02 + 0.03 * t, 0.5);
    }
    seen * seen * (3.0 - 2.0 * seen)
}

/// Linear light as sRGB bytes, with highlights rolled off instead of cut.
fn expose(linear: Vec3) -> [u8; 3] {
    to_srgb(linear * 1.12 / (Vec3::ONE + 0.12 * linear * linear))
}

/// The colour (sRGB) that a camera sees a surface point in.
pub(crate) fn colour_at(scene: &Scene, point: Vec3) -> [u8; 3] {
    match scene.sample(point) {
        Some(sample) => {
            let light = light(scene, point, sample.normal, true) + scene.objects()[sample.object].glow();
            expose(sample.albedo * light)
        }
        None => [0; 3],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Bounds, Material, Object, Shape};
    use glam::{DQuat, DVec3};

    const CAMERA: Intrinsics = Intrinsics::new(80, 60, 66.0, 65.0, 39.5, 29.5);

    fn scene(objects: Vec<Object>) -> Scene {
        Scene::new(objects, Bounds::new(Vec3::splat(-4.0), Vec3::splat(4.0)))
    }

    fn view() -> Se3 {
        let rotation = DQuat::from_rotation_y(0.3) * DQuat::from_rotation_x(-0.25) * DQuat::from_rotation_z(0.1);
        Se3::new(rotation, DVec3::new(-0.4, -1.3, -1.7))
    }

    /// Compares depth with closed forms: the distance along a ray, or `None` where it misses.
    fn check(shape: Object, truth: impl Fn(DVec3, DVec3) -> Option<f64>, world_from_camera: Se3) {
        let rendering = render(&scene(vec![shape]), &CAMERA, &world_from_camera, Quality::Draft);
        let mut hits = 0;
        for y in 0..CAMERA.height {
            for x in 0..CAMERA.width {
                // Of length 1 along the optical axis, so that the ray's parameter is depth.
                let ray = CAMERA.unproject(DVec2::new(x.into(), y.into()), 1.0);
                let expected = truth(world_from_camera.translation, world_from_camera.transform_vector(ray));
                let expected = expected.filter(|z| *z > 0.0 && z * ray.length() < f64::from(FAR_M)).unwrap_or(0.0);
                let found = f64::from(rendering.depth[(x, y)]);
                assert!((found - expected).abs() < 1e-4, "pixel {x}, {y}: {found} m, not {expected} m");
                hits += usize::from(expected > 0.0);
            }
        }
        assert!(hits > 300, "only {hits} pixels see anything");
    }

    #[test]
    fn depth_of_a_plane_is_that_of_the_closed_form() {
        let floor = Object::new(Shape::Plane, Material::default());
        check(floor, |o, d| (d.y > 0.0).then(|| -o.y / d.y), view());
    }

    #[test]
    fn depth_of_a_ball_is_that_of_the_closed_form() {
        let (centre, radius) = (DVec3::new(0.1, -0.9, 0.2), 0.6);
        let ball = Object::new(Shape::Sphere { radius: radius as f32 }, Material::default()).at(0.1, -0.9, 0.2);
        let truth = |o: DVec3, d: DVec3| {
            let (oc, dd) = (o - centre, d.length_squared());
            let b = oc.dot(d) / dd;
            let discriminant = b * b - (oc.length_squared() - radius * radius) / dd;
            (discriminant > 0.0).then(|| -b - discriminant.sqrt())
        };
        check(ball, truth, view());
    }

    #[test]
    fn depth_of_a_box_is_that_of_the_closed_form() {
        let turn = DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(0.2);
        let (centre, half) = (DVec3::new(0.1, -0.9, 0.2), DVec3::new(0.5, 0.3, 0.4));
        let solid =
            Object::new(Shape::cuboid(1.0, 0.6, 0.8), Material::default()).at(0.1, -0.9, 0.2).turned(turn.as_quat());
        let truth = |o: DVec3, d: DVec3| {
            let (o, d) = (turn.inverse() * (o - centre), turn.inverse() * d);
            let (a, b) = ((-half - o) / d, (half - o) / d);
            let (enter, leave) = (a.min(b).max_element(), a.max(b).min_element());
            (enter < leave).then_some(enter)
        };
        check(solid, truth, view());
    }

    #[test]
    fn normals_face_the_camera_in_its_own_axes() {
        let floor = Object::new(Shape::Plane, Material::default());
        let down = Se3::new(DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2), DVec3::new(0.0, -2.0, 0.0));
        let rendering = render(&scene(vec![floor]), &CAMERA, &down, Quality::Draft);
        assert!(rendering.normals.data().iter().all(|n| n.abs_diff_eq(-Vec3::Z, 1e-6)));
    }

    #[test]
    fn a_point_has_the_same_colour_from_everywhere() {
        let room = Scene::room();
        let blank = |camera: &Intrinsics, pose: &Se3, point: DVec3| {
            let pixel = camera.project(pose.inverse().transform_point(point)).unwrap();
            // The camera is turned so that the middle of a pixel sees the point.
            assert!((pixel - pixel.round()).length() < 1e-3, "{pixel}");
            let (x, y) = (pixel.x.round() as u32, pixel.y.round() as u32);
            render(&room, camera, pose, Quality::Draft).colour[(x, y)]
        };
        let point = DVec3::new(-0.45, -1.5, 1.953);
        let camera = Intrinsics::new(3, 3, 400.0, 400.0, 1.0, 1.0);
        let colours: Vec<_> = [DVec3::new(-0.4, -1.3, 0.0), DVec3::new(0.5, -1.5, 0.4), DVec3::new(-0.9, -1.1, -0.6)]
            .into_iter()
            .map(|from| {
                let rotation = DQuat::from_rotation_arc(DVec3::Z, (point - from).normalize());
                blank(&camera, &Se3::new(rotation, from), point)
            })
            .collect();
        for c in &colours {
            let apart = c.iter().zip(&colours[0]).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
            assert!(apart <= 6, "{colours:?}");
        }
    }

    #[test]
    fn images_of_any_size_and_scenes_without_anything_are_fine() {
        let camera = Intrinsics::new(1, 1, 1.0, -1.0, 0.0, 0.0);
        let empty = render(&scene(Vec::new()), &camera, &Se3::IDENTITY, Quality::Fine);
        assert_eq!((empty.depth.data(), empty.colour.data()), ([0.0].as_slice(), [[0, 0, 0, 255]].as_slice()));
        let upside_down = Intrinsics::new(7, 5, 6.0, -6.0, 3.0, 2.0);
        let floor = scene(vec![Object::new(Shape::Plane, Material::default())]);
        let pose = Se3::new(DQuat::IDENTITY, DVec3::new(0.0, -1.0, 0.0));
        let depth = render(&floor, &upside_down, &pose, Quality::Fine).depth;
        assert!(depth[(3, 0)] > 0.0 && depth[(3, 4)] == 0.0, "y points up in this camera, so the floor is at the top");
    }
}
