//! Whether the ten rooms are alike but for one object each.

use glam::{DQuat, DVec2, DVec3, Vec3};
use itm_core::{Image, Intrinsics, Se3};
use itm_synth::{Path, Scene, Spec, render_depth};

const PITCH_M: f64 = 3.625;

fn middle(room: u32) -> f64 {
    PITCH_M * (f64::from(room) - 4.5)
}

/// Depth as seen in a room from where the path looks around, turned by `yaw_degrees` to the right of +z.
fn look_around(scene: &Scene, camera: &Intrinsics, room: u32, yaw_degrees: f64) -> (Image<f32>, Se3) {
    let rotation = DQuat::from_rotation_y(yaw_degrees.to_radians()) * DQuat::from_rotation_x(-0.2);
    let pose = Se3::new(rotation, DVec3::new(middle(room) + 0.1, -1.4, -0.65));
    (render_depth(scene, camera, &pose).0, pose)
}

/// Whether a point is where a room has the object that the others have not, on the chest or just above it.
fn is_objects_place(room: u32, point: DVec3) -> bool {
    let from_chest = point - DVec3::new(middle(room) - 0.75, -0.5, 1.4);
    from_chest.x.abs() < 0.35 && from_chest.z.abs() < 0.25 && (-0.7..0.0).contains(&from_chest.y)
}

#[test]
fn rooms_differ_where_the_object_is_and_nowhere_else() {
    let scene = Scene::rooms();
    let camera = Spec::new(Path::Rooms).with_size(120, 90).camera;
    for yaw_degrees in [-35.0, 0.0, 20.0] {
        let views: Vec<_> = (0..10).map(|room| look_around(&scene, &camera, room, yaw_degrees)).collect();
        for a in 0..10 {
            for b in 0..a {
                let (mut different, mut elsewhere) = (0, Vec::new());
                let [(depth_a, pose_a), (depth_b, pose_b)] = [a, b].map(|room| &views[room as usize]);
                for (x, y) in (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y))) {
                    let (z_a, z_b) = (depth_a[(x, y)], depth_b[(x, y)]);
                    if (z_a - z_b).abs() < 1e-3 {
                        continue;
                    }
                    // One of them sees the object, the other one that of its own or what is behind.
                    let point = |z: f32, pose: &Se3| {
                        pose.transform_point(camera.unproject(DVec2::new(x.into(), y.into()), z.into()))
                    };
                    let on_object = is_objects_place(a, point(z_a, pose_a)) || is_objects_place(b, point(z_b, pose_b));
                    if !on_object {
                        elsewhere.push((x, y, z_a, z_b));
                    }
                    different += 1;
                }
                // Rounding decides whether a ray that grazes an edge passes it.
                assert!(elsewhere.len() <= 2, "rooms {a} and {b}, {yaw_degrees} degrees: {elsewhere:?}");
                // Looking to the right, the object is out of view.
                assert!(yaw_degrees >= 0.0 || different > 40, "rooms {a} and {b} differ in {different} pixels only");
            }
        }
    }
}

#[test]
fn walls_have_the_same_patterns_in_all_rooms() {
    let scene = Scene::rooms();
    let albedo = |room: u32, x: f32, y: f32, z: f32| {
        scene.sample(Vec3::new(middle(room) as f32 + x, y, z)).expect("there are walls").albedo
    };
    let places = (0..1000).map(|i| (-0.25 - 0.1 * (i % 23) as f32, -1.7 + 0.1 * (i / 23 % 34) as f32));
    for room in 1..10 {
        // At the edge of a brick, rounding may decide otherwise.
        let different = places
            .clone()
            .flat_map(|(y, along)| [(-1.7, y, along), (1.7, y, along), (along, y, 1.74), (along, y, -1.74)])
            // The openings, which are closed at the row's ends.
            .filter(|&(x, _, z)| x.abs() < 1.6 || !(-1.4..0.2).contains(&z))
            .filter(|&(x, y, z)| albedo(room, x, y, z).distance(albedo(0, x, y, z)) > 0.01)
            .count();
        assert!(different < 20, "room {room} differs at {different} of 4000 places");
    }
}
