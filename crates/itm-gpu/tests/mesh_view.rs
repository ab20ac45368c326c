//! Stage `mesh_view`: against its reference on a ball and a box.

mod common;

use std::f32::consts::{PI, TAU};

use glam::{DVec3, Vec3};
use itm_core::{Intrinsics, Mesh, Se3};
use itm_gpu::mesh_view::MeshView;
use itm_gpu::render::{Scale, Shading};
use itm_gpu::{Canvas, Device, Error, Recorder, reference};

const SHADINGS: [Shading; 6] =
    [Shading::Grey, Shading::Phong, Shading::Normals, Shading::Colour, Shading::Depth, Shading::Confidence];
const SCALE: Scale = Scale { depth_m: [0.5, 2.5], confidence: 30.0 };
const FAR_M: f32 = 6.0;

/// A ball of 384 triangles with what a map gives a mesh, and in front of it an open box seen from its inside and outside.
fn scene() -> Mesh {
    let mut mesh = Mesh::default();
    let (rings, segments) = (9_u32, 24_u32);
    for ring in 0..rings {
        for segment in 0..segments {
            let (down, around) = (ring as f32 / (rings - 1) as f32 * PI, segment as f32 / segments as f32 * TAU);
            let normal = Vec3::new(down.sin() * around.cos(), down.cos(), down.sin() * around.sin());
            mesh.normals.push(normal);
            mesh.positions.push(Vec3::new(0.3, 0.2, 0.9) + 0.5 * normal);
            if ring + 1 < rings {
                let at = |ring, segment| ring * segments + segment % segments;
                let [a, b] = [at(ring, segment), at(ring, segment + 1)];
                let [c, d] = [at(ring + 1, segment), at(ring + 1, segment + 1)];
                mesh.triangles.extend([[a, b, c], [b, d, c]]);
            }
        }
    }
    // The box: no lid towards the camera, and faces that share no vertices.
    for (normal, along) in [(Vec3::X, Vec3::Y), (Vec3::NEG_X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::NEG_Y, Vec3::Z)] {
        let first = mesh.positions.len() as u32;
        for (u, v) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
            mesh.positions.push(Vec3::new(-0.4, -0.2, 0.5) + 0.25 * (normal + u * along + v * normal.cross(along)));
            mesh.normals.push(normal);
        }
        mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
    for (i, p) in mesh.positions.iter().enumerate() {
        mesh.colours.push((127.5 + 127.0 * (5.0 * *p).map(f32::sin)).to_array().map(|c| c as u8));
        mesh.weights.push((i % 40) as u16);
        mesh.confidences.push(15.0 + 14.0 * (7.0 * p.x).sin());
    }
    mesh.check().expect("its parts fit together");
    mesh
}

/// Compares a picture with the reference's, and returns how many pixels show something.
fn compare(device: &Device, mesh: &Mesh, camera: &Intrinsics, pose: &Se3, shading: Shading) -> usize {
    let canvas = Canvas::new(device, (camera.width, camera.height)).expect("a small canvas");
    let view = MeshView::new(device, mesh).expect("a small mesh");
    let mut recorder = Recorder::new(device);
    view.paint(&mut recorder, camera, pose, FAR_M, shading, &SCALE, &canvas);
    canvas.show(&mut recorder);
    let _untimed = recorder.submit();
    let painted = canvas.read(device).expect("the device answers");
    let (expected, depths) = reference::mesh_view::paint(mesh, camera, pose, FAR_M, shading, &SCALE);
    let close = |a: [u8; 4], b: [u8; 4]| (0..4).all(|i| a[i].abs_diff(b[i]) <= 2);
    let differ = painted.data().iter().zip(expected.data()).filter(|(a, b)| !close(**a, **b)).count();
    // Where a pixel's centre lies on an edge, rounding decides.
    assert!(differ * 100 <= camera.pixels() * 3, "{differ} pixels in {shading:?}");
    // Depth is the same in each shading, and reading it is a wait for each pixel.
    if shading == Shading::Depth {
        let pixels = (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y)));
        let differ = pixels.filter(|&at| {
            let depth = canvas.depth(device, at).expect("the device answers");
            depth.is_some() != (depths[at] > 0.0) || (depth.unwrap_or(0.0) - depths[at]).abs() > 1e-3
        });
        let differ = differ.count();
        assert!(differ * 100 <= camera.pixels() * 3, "{differ} depths");
    }
    expected.data().iter().filter(|pixel| pixel[3] > 0).count()
}

#[test]
fn pictures_are_the_references() {
    let Some(device) = common::device() else { return };
    let (mesh, camera) = (scene(), common::camera(97, 61));
    for pose in &common::poses()[..2] {
        for shading in SHADINGS {
            let shown = compare(device, &mesh, &camera, pose, shading);
            assert!((1000..camera.pixels() - 500).contains(&shown), "{shown} pixels show something");
        }
    }
}

#[test]
fn cameras_may_have_any_principal_point_and_a_y_axis_that_points_up() {
    let Some(device) = common::device() else { return };
    for camera in [Intrinsics::new(97, 61, 84.0, -86.0, 30.25, 41.0), Intrinsics::new(64, 48, 70.0, 95.0, -3.0, -5.25)]
    {
        for shading in [Shading::Normals, Shading::Depth] {
            assert!(compare(device, &scene(), &camera, &common::poses()[0], shading) > 500);
        }
    }
}

#[test]
fn a_triangle_from_behind_the_camera_to_the_far_plane_is_cut() {
    let Some(device) = common::device() else { return };
    let mesh = Mesh {
        positions: vec![Vec3::new(-0.5, 0.3, -1.0), Vec3::new(0.6, 0.4, -1.0), Vec3::new(0.0, 0.2, 9.0)],
        normals: vec![Vec3::NEG_Y; 3],
        colours: vec![[255, 0, 0], [0, 255, 0], [0, 0, 255]],
        triangles: vec![[0, 2, 1]],
        ..Mesh::default()
    };
    let camera = common::camera(97, 61);
    for shading in [Shading::Colour, Shading::Depth] {
        assert!(compare(device, &mesh, &camera, &Se3::IDENTITY, shading) > 300);
    }
}

#[test]
fn what_a_mesh_lacks_is_shown_as_grey() {
    let Some(device) = common::device() else { return };
    let (camera, pose) = (common::camera(97, 61), common::poses()[1]);
    // Confidences before weights.
    let weighted = Mesh { confidences: Vec::new(), ..scene() };
    compare(device, &weighted, &camera, &pose, Shading::Confidence);
    let mut bare = Mesh { colours: Vec::new(), weights: Vec::new(), ..weighted };
    bare.compute_normals();
    let picture = |mesh: &Mesh, shading| {
        let canvas = Canvas::new(device, (camera.width, camera.height)).unwrap();
        let mut recorder = Recorder::new(device);
        MeshView::new(device, mesh).unwrap().paint(&mut recorder, &camera, &pose, FAR_M, shading, &SCALE, &canvas);
        let _untimed = recorder.submit();
        canvas.read(device).unwrap()
    };
    let grey = picture(&bare, Shading::Grey);
    let without_normals = Mesh { normals: Vec::new(), ..bare };
    for shading in [Shading::Grey, Shading::Colour, Shading::Confidence] {
        assert_eq!(picture(&without_normals, shading), grey, "{shading:?}");
    }
}

#[test]
fn an_empty_mesh_takes_away_what_was_painted() {
    let Some(device) = common::device() else { return };
    let (camera, pose) = (common::camera(97, 61), common::poses()[0]);
    let canvas = Canvas::new(device, (camera.width, camera.height)).unwrap();
    let ball = camera.project(pose.inverse().transform_point(DVec3::new(0.3, 0.2, 0.9))).unwrap().as_uvec2().into();
    for (mesh, shows) in [(scene(), true), (Mesh::default(), false)] {
        let view = MeshView::new(device, &mesh).unwrap();
        let mut recorder = Recorder::timed(device);
        view.paint(&mut recorder, &camera, &pose, FAR_M, Shading::Grey, &SCALE, &canvas);
        let times = recorder.submit().read(device).unwrap();
        assert!(times.iter().all(|(stage, ms)| *stage == "mesh_view" && *ms >= 0.0), "{times:?}");
        let painted = canvas.read(device).unwrap();
        assert_eq!(painted.data().iter().any(|pixel| *pixel != [0; 4]), shows);
        assert_eq!(canvas.depth(device, ball).unwrap().is_some(), shows);
    }
}

#[test]
fn a_mesh_larger_than_a_buffer_is_shown_in_parts() {
    let Some(_) = common::device() else { return };
    let device = common::device_with_bindings_of(16 << 20);
    // A wall of more vertices than 16 MiB hold, at 2 m.
    let side = 760_u32;
    let mut mesh = Mesh::default();
    for i in 0..side * side {
        let (x, y) = (i % side, i / side);
        mesh.positions.push(Vec3::new(x as f32 / side as f32 - 0.5, y as f32 / side as f32 - 0.5, 0.5) * 4.0);
        if x + 1 < side && y + 1 < side {
            mesh.triangles.extend([[i, i + side, i + 1], [i + 1, i + side, i + side + 1]]);
        }
    }
    let camera = common::camera(97, 61);
    let canvas = Canvas::new(&device, (camera.width, camera.height)).unwrap();
    let view = MeshView::new(&device, &mesh).unwrap();
    let mut recorder = Recorder::new(&device);
    let scale = Scale::default();
    view.paint(&mut recorder, &camera, &Se3::IDENTITY, FAR_M, Shading::Normals, &scale, &canvas);
    let _untimed = recorder.submit();
    let painted = canvas.read(&device).unwrap();
    assert!(painted.data().iter().all(|p| p[2] == 0 && p[3] == 255), "the wall's normals point to the camera");
    device.check().unwrap();
}

#[test]
fn a_mesh_that_does_not_fit_together_is_refused() {
    let Some(device) = common::device() else { return };
    let mesh = Mesh { positions: vec![Vec3::ZERO; 3], triangles: vec![[0, 1, 3]], ..Mesh::default() };
    let error = MeshView::new(device, &mesh).unwrap_err();
    assert!(matches!(error, Error::Mesh { .. }) && error.to_string().contains("triangle 0"), "{error}");
}
