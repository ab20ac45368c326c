//! Stages `ranges`, `raycast`, `normals` and `icp` on the device, against their references and against scenes whose truth
//! is known.

mod common;

use std::f64::consts::PI;

use common::{Fusion, Gpu, RANGE_M, Scene, Shape, quantile, to_reference};
use glam::{DVec2, DVec3, IVec3};
use itm_core::{Image, Intrinsics, Se3};
use itm_gpu::icp::{Icp, NormalEquations};
use itm_gpu::{RaycastImage, reference};
use nalgebra::{Matrix6, Vector6};
use proptest::prelude::*;

const VOXEL_M: f32 = 0.03;

/// The room, fused from several poses, and cast from another one.
struct Cast {
    fusion: Fusion,
    image: RaycastImage,
    camera: Intrinsics,
    pose: Se3,
}

fn cast(gpu: &Gpu, scene: &Scene, fused_from: &[Se3], camera: Intrinsics, pose: Se3) -> Cast {
    let depth_camera = common::camera(100, 75);
    let mut fusion = Fusion::new(gpu, depth_camera, VOXEL_M, false, 4_000);
    for pose in fused_from {
        fusion.fuse(gpu, &common::frame(scene.depth(&depth_camera, pose), None), pose);
    }
    let image = fusion.cast(gpu, camera, &pose);
    Cast { fusion, image, camera, pose }
}

impl Cast {
    fn points(&self, gpu: &Gpu) -> Image<[f32; 4]> {
        self.image.read_points(&gpu.device).expect("the device answers")
    }

    fn normals(&self, gpu: &Gpu) -> Image<[f32; 4]> {
        self.image.read_normals(&gpu.device).expect("the device answers")
    }

    fn visible(&self, gpu: &Gpu) -> Vec<IVec3> {
        let keys = self.fusion.keys();
        self.fusion.visible(gpu).iter().map(|i| keys[*i as usize].position).collect()
    }
}

fn size() -> impl Strategy<Value = (u32, u32)> {
    prop_oneof![Just((1, 1)), Just((81, 61)), Just((64, 48)), (1..100u32, 1..80u32)]
}

/// A pose near those that the room was fused from.
fn pose() -> impl Strategy<Value = Se3> {
    let (t, r) = (-0.1..0.1, -0.2..0.2);
    [t.clone(), t.clone(), t, r.clone(), r.clone(), r].prop_map(|twist| common::poses()[0] * Se3::exp(twist))
}

proptest! {
    #![proptest_config(common::cases(8))]

    #[test]
    fn ranges_bound_the_visible_blocks(size in size(), offset in pose(), negative_fy: bool, inside: bool) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let camera = common::camera(size.0, size.1);
        let camera = if negative_fy { Intrinsics { fy: -camera.fy, ..camera } } else { camera };
        // From between the blocks of the ball's surface, too, so that some reach behind the camera.
        let into = if inside { 1.5 } else { 0.0 };
        let pose = offset * Se3::exp([0.3, 0.2, into, 0.0, 0.0, 0.0]);
        let cast = cast(gpu, &Scene::room(), &common::poses()[..1], camera, pose);
        let found = cast.image.read_ranges(&gpu.device).unwrap();

        // The device widens each block's box by a pixel; which range pixels a box that ends at their border touches may
        // depend on rounding.
        let map = reference::Map::new(VOXEL_M, 4.0 * VOXEL_M);
        let visible = cast.visible(gpu);
        let surely = reference::ranges::ranges(&map, &visible, &camera, &pose, 1.0 - 0.05);
        let perhaps = reference::ranges::ranges(&map, &visible, &camera, &pose, 1.0 + 0.05);
        prop_assert_eq!(found.size(), surely.size());
        for ((found, surely), perhaps) in found.data().iter().zip(surely.data()).zip(perhaps.data()) {
            // Depths of a few metres in single precision.
            let covers = |a: &Option<[f32; 2]>, b: &Option<[f32; 2]>| match (a, b) {
                (_, None) => true,
                (None, Some(_)) => false,
                (Some(a), Some(b)) => a[0] <= b[0] + 2e-6 && a[1] >= b[1] - 2e-6,
            };
            prop_assert!(covers(found, surely), "{found:?} does not cover {surely:?}");
            prop_assert!(covers(perhaps, found), "{found:?} exceeds {perhaps:?}");
        }
    }

    #[test]
    fn rays_hit_what_the_references_rays_hit(size in size(), pose in pose(), negative_fy: bool) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let camera = common::camera(size.0, size.1);
        let camera = if negative_fy { Intrinsics { fy: -camera.fy, ..camera } } else { camera };
        let cast = cast(gpu, &Scene::room(), &common::poses(), camera, pose);
        let found = cast.points(gpu);
        let map = cast.fusion.read();
        let ranges = cast.image.read_ranges(&gpu.device).unwrap();
        let expected = reference::raycast::raycast(&map, &ranges, &camera, &pose, RANGE_M[0]);
        let mut different = 0;
        for (found, expected) in found.data().iter().zip(expected.data()) {
            let [x, y, z, w] = found.map(f64::from);
            let point = DVec3::new(x, y, z);
            prop_assert!(w > 0.0 || point == DVec3::ZERO);
            let same = match expected {
                None => w == 0.0,
                // A few roundings of positions of some metres.
                Some(hit) => w == f64::from(hit.weight) + 1.0 && hit.point.abs_diff_eq(point, 2e-5),
            };
            different += u32::from(!same);
        }
        // Where a step ends within rounding of the border between two voxels or blocks, rays go on by different steps, and
        // may find another part of an edge. Few do.
        let pixels = found.data().len() as u32;
        prop_assert!(different <= 1 + pixels / 100, "{different} of {pixels} rays differ");
    }

    #[test]
    fn normals_are_those_of_the_neighbouring_points(size in size(), pose in pose()) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let camera = common::camera(size.0, size.1);
        let cast = cast(gpu, &Scene::room(), &common::poses(), camera, pose);
        let (points, found) = (to_reference(&cast.points(gpu)), cast.normals(gpu));
        // Differences whose length is within rounding of the limit may be taken or not.
        let margin_m = 1e-6;
        let [narrow, wide] = [-margin_m, margin_m].map(|m| reference::normals::normals(&points, pose.translation, m));
        for ((found, narrow), wide) in found.data().iter().zip(narrow.data()).zip(wide.data()) {
            let [x, y, z, w] = found.map(f64::from);
            let normal = DVec3::new(x, y, z);
            let same = |expected: &Option<DVec3>| match expected {
                None => w == 0.0 && normal == DVec3::ZERO,
                // The inputs are the same numbers: a few roundings, and those of a nearly empty product.
                Some(expected) => w == 1.0 && normal.abs_diff_eq(*expected, 1e-4),
            };
            prop_assert!(same(narrow) || same(wide), "{found:?} but {narrow:?}");
        }
    }

    #[test]
    fn the_sums_of_icp_are_the_references(size in size(), pose in pose(), error in pose(), level in 0..3usize, cm in 1..20u32) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let camera = common::camera(size.0, size.1);
        let mut cast = cast(gpu, &Scene::room(), &common::poses(), camera, pose);
        // The frame to align: the third pose's, taken to be somewhere near it.
        let guess = common::poses()[2] * Se3::exp(error.log().map(|v| 0.05 * v));
        let max_distance_m = cm as f32 * 0.01;
        let frame_depth = Scene::room().depth(&cast.fusion.calibration.depth, &common::poses()[2]);
        cast.fusion.allocate(gpu, &common::frame(frame_depth, None), &guess);
        let view = &cast.fusion.view;
        let found = Icp::new(&gpu.device).evaluate(view, level, &guess, &cast.image, &pose, max_distance_m).unwrap();

        let model = model(&cast, gpu);
        let depth = view.read_depth(&gpu.device, level).unwrap();
        let level_camera = view.level_camera(level);
        let expected = reference::icp::icp(&model, &depth, level_camera, &guess, max_distance_m);
        let slack = icp_slack(&model, &depth, level_camera, &guess, max_distance_m.into());
        prop_assert_eq!(found.valid, expected.valid);
        prop_assert!(found.count.abs_diff(expected.count) <= slack.count, "{} but {}", found.count, expected.count);
        prop_assert!((found.squares - expected.squares).abs() <= slack.squares, "{} but {}", found.squares, expected.squares);
        for i in 0..6 {
            for j in 0..6 {
                let (a, b) = (found.hessian[i][j], expected.hessian[i][j]);
                prop_assert!((a - b).abs() <= slack.hessian[i][j], "JtJ {i} {j}: {a} but {b}");
            }
            let (a, b) = (found.gradient[i], expected.gradient[i]);
            prop_assert!((a - b).abs() <= slack.gradient[i], "Jtr {i}: {a} but {b}");
        }
    }
}

fn model(cast: &Cast, gpu: &Gpu) -> reference::icp::Model {
    reference::icp::Model {
        points: to_reference(&cast.points(gpu)),
        normals: to_reference(&cast.normals(gpu)),
        camera: cast.camera,
        world_from_camera: cast.pose,
    }
}

/// How far single precision may take the sums away from the reference's.
fn icp_slack(
    model: &reference::icp::Model,
    depth: &Image<f32>,
    camera: &Intrinsics,
    guess: &Se3,
    max_distance_m: f64,
) -> NormalEquations {
    // A pixel's share is known up to positions' rounding of about 2e-6 m, and sums of up to 1024 in a row lose up to
    // 6e-8 at each addition: a share of 1e-5 in all, more than ever happens.
    const SHARE: f64 = 1e-5;
    let pivot = model.world_from_camera.translation;
    let mut slack = NormalEquations { hessian: [[1e-6; 6]; 6], gradient: [1e-6; 6], squares: 1e-6, count: 0, valid: 0 };
    for y in 0..depth.height() {
        for x in 0..depth.width() {
            let Some((world, pixel)) = reference::icp::project_into_model(model, depth, camera, guess, x, y) else {
                continue;
            };
            // Where rounding decides which pixel of the model is the nearest, or whether it is near enough, all of the
            // largest share that a pixel can have may come or go.
            let near_integer = |v: f64| (v - v.round()).abs() < 1e-3;
            let on_border = near_integer(pixel.x + 0.5)
                || near_integer(pixel.y + 0.5)
                || model
                    .points
                    .get((pixel.x + 0.5) as u32, (pixel.y + 0.5) as u32)
                    .copied()
                    .flatten()
                    .is_some_and(|point| (point.distance(world) - max_distance_m).abs() < 1e-5);
            let arm = world.distance(pivot);
            let largest = [1.0, 1.0, 1.0, arm, arm, arm];
            let residual = if on_border {
                slack.count += 1;
                max_distance_m
            } else {
                match reference::icp::pair(model, world, pixel, max_distance_m) {
                    Some(pair) => pair.residual([0.0; 6], pivot).abs(),
                    None => continue,
                }
            };
            let share = if on_border { 1.0 } else { SHARE };
            // The residual itself is uncertain by the roundings of the positions.
            let residual_error = if on_border { residual } else { 2e-6 };
            for i in 0..6 {
                for j in 0..6 {
                    slack.hessian[i][j] += share * largest[i] * largest[j];
                }
                slack.gradient[i] += largest[i] * (share * residual + residual_error);
            }
            slack.squares += share * residual * residual + 2.0 * residual * residual_error;
        }
    }
    slack
}

/// Scenes of one kind of surface each, and the room, with poses to fuse them from.
fn scenes() -> Vec<(&'static str, Scene, Vec<Se3>)> {
    let tilted = DVec3::new(0.3, -0.2, 1.0).normalize();
    let alone = |shape| Scene(vec![shape]);
    let around: Vec<Se3> =
        [[0.0; 6], [0.2, 0.1, 0.0, 0.05, -0.12, 0.1], [-0.25, 0.0, 0.1, 0.0, 0.15, -0.2]].map(Se3::exp).to_vec();
    vec![
        ("a wall", alone(Shape::Plane { normal: DVec3::Z, distance: 1.713 }), around[..1].to_vec()),
        ("a tilted plane", alone(Shape::Plane { normal: tilted, distance: 1.5 }), around.clone()),
        ("a ball", alone(Shape::Sphere { centre: DVec3::new(0.05, 0.0, 1.6), radius: 0.6 }), around.clone()),
        (
            "a box",
            alone(Shape::Cuboid { centre: DVec3::new(0.1, 0.05, 1.9), half: DVec3::new(0.5, 0.4, 0.5) }),
            around.clone(),
        ),
        ("a room", Scene::room(), common::poses().to_vec()),
    ]
}

#[test]
fn surfaces_come_back_where_they_are() {
    let Some(gpu) = common::gpu() else { return };
    for (name, scene, poses) in scenes() {
        let camera = common::camera(81, 61);
        let cast = cast(gpu, &scene, &poses, camera, poses[0]);
        let truth = scene.depth(&camera, &cast.pose);
        let found = to_reference(&cast.points(gpu));
        let normals = to_reference(&cast.normals(gpu));
        let ranges = cast.image.read_ranges(&gpu.device).unwrap();
        let expected = reference::raycast::raycast(&cast.fusion.read(), &ranges, &camera, &cast.pose, RANGE_M[0]);
        let reference_points = Image::from_fn(81, 61, |x, y| expected[(x, y)].map(|hit| hit.point));
        let reference_normals = reference::normals::normals(&reference_points, cast.pose.translation, 0.0);

        for (who, points, normals) in
            [("device", &found, &normals), ("reference", &reference_points, &reference_normals)]
        {
            let (mut off_voxels, mut off_degrees, mut there, mut hit) = (Vec::new(), Vec::new(), 0, 0);
            for y in 0..61 {
                for x in 0..81 {
                    there += usize::from((RANGE_M[0]..RANGE_M[1]).contains(&truth[(x, y)]));
                    let Some(point) = points[(x, y)] else { continue };
                    hit += 1;
                    off_voxels.push(scene.distance(point) / f64::from(VOXEL_M));
                    if let Some(normal) = normals[(x, y)] {
                        let exact = scene.normal(point, cast.pose.translation);
                        off_degrees.push(exact.dot(normal).clamp(-1.0, 1.0).acos().to_degrees());
                    }
                }
            }
            let context = format!("{who}, {name}");
            assert!(hit * 100 >= there * 90, "{context}: only {hit} of {there} rays hit");
            assert!(off_degrees.len() * 100 >= hit * 80, "{context}: only {} normals", off_degrees.len());
            let [median, most] = [0.5, 0.95].map(|share| quantile(off_voxels.clone(), share));
            assert!(median < 0.1, "{context}: {median} voxels off");
            assert!(most < 1.0, "{context}: one of twenty points is {most} voxels off");
            let median = quantile(off_degrees, 0.5);
            assert!(median < 2.0, "{context}: normals are {median} degrees off");
        }
    }
}

#[test]
fn a_map_seen_from_behind_or_from_where_it_is_not_shows_nothing() {
    let Some(gpu) = common::gpu() else { return };
    let scene = Scene(vec![Shape::Plane { normal: DVec3::Z, distance: 1.5 }]);
    let camera = common::camera(81, 61);
    let looking_back_from = |z| Se3 { translation: DVec3::new(0.0, 0.0, z), ..Se3::exp([0.0, 0.0, 0.0, 0.0, PI, 0.0]) };
    // From behind the wall, and from before it, turned away.
    for pose in [looking_back_from(3.0), looking_back_from(1.0)] {
        let cast = cast(gpu, &scene, &[Se3::IDENTITY], camera, pose);
        assert!(cast.points(gpu).data().iter().all(|p| *p == [0.0; 4]), "{pose:?}");
        assert!(cast.normals(gpu).data().iter().all(|p| *p == [0.0; 4]), "{pose:?}");
    }
}

/// The step that a Gauss-Newton iteration takes.
fn step(sums: &NormalEquations) -> [f64; 6] {
    let hessian = Matrix6::from_fn(|i, j| sums.hessian[i][j]);
    let gradient = Vector6::from_fn(|i, _| sums.gradient[i]);
    (-hessian.cholesky().expect("the room fixes all six directions").solve(&gradient)).into()
}

/// A motion about a pivot, as `NormalEquations` means it.
fn about(pivot: DVec3, twist: [f64; 6]) -> Se3 {
    let to_pivot = Se3 { translation: pivot, ..Se3::IDENTITY };
    to_pivot * Se3::exp(twist) * to_pivot.inverse()
}

#[test]
fn icp_stays_at_the_truth_and_comes_back_to_it() {
    let Some(gpu) = common::gpu() else { return };
    let camera = common::camera(100, 75);
    let truth = common::poses()[0];
    let mut cast = cast(gpu, &Scene::room(), &common::poses(), camera, truth);
    // The depth of the pose that the model was cast from.
    cast.fusion.allocate(gpu, &common::frame(Scene::room().depth(&camera, &truth), None), &truth);
    let mut icp = Icp::new(&gpu.device);
    let mut evaluate =
        |pose: &Se3, level| icp.evaluate(&cast.fusion.view, level, pose, &cast.image, &truth, 0.1).unwrap();

    let sums = evaluate(&truth, 0);
    assert!(sums.count * 10 > sums.valid * 8, "{sums:?}");
    assert!((sums.squares / f64::from(sums.count)).sqrt() < 0.2 * f64::from(VOXEL_M), "{sums:?}");
    let at_truth = step(&sums);
    assert!(at_truth.iter().all(|s| s.abs() < 0.003), "the step at the true pose is {at_truth:?}, a tenth of a voxel");

    for error in [[0.02, -0.01, 0.015, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.02, -0.015, 0.01], [-0.015; 6]] {
        let mut pose = about(truth.translation, error) * truth;
        for level in [2, 2, 2, 1, 1, 1, 0, 0, 0] {
            pose = about(truth.translation, step(&evaluate(&pose, level))) * pose;
        }
        let left = truth.inverse() * pose;
        // A fused map is off by a small part of a voxel, and so is what fits to it best.
        assert!(
            left.translation.length() < 0.1 * f64::from(VOXEL_M),
            "{error:?}: {} m left",
            left.translation.length()
        );
        assert!(left.angle().to_degrees() < 0.15, "{error:?}: {} degrees left", left.angle().to_degrees());
    }
}

#[test]
fn the_gradient_of_icp_is_the_slope_of_its_squares() {
    let Some(gpu) = common::gpu() else { return };
    // A wall: moving along it changes neither partners' planes nor who is a pair, so that the sum of squares is smooth.
    let scene = Scene(vec![Shape::Plane { normal: DVec3::new(0.1, -0.15, 1.0).normalize(), distance: 1.6 }]);
    let camera = common::camera(100, 75);
    let mut cast = cast(gpu, &scene, &[Se3::IDENTITY], camera, Se3::IDENTITY);
    // A part of the image, so that its border stays away from the model's.
    let whole = scene.depth(&camera, &Se3::IDENTITY);
    let part =
        Image::from_fn(
            100,
            75,
            |x, y| {
                if (20..80).contains(&x) && (15..60).contains(&y) { whole[(x, y)] } else { 0.0 }
            },
        );
    cast.fusion.allocate(gpu, &common::frame(part, None), &Se3::IDENTITY);
    let mut icp = Icp::new(&gpu.device);
    let pose = Se3::exp([0.004, 0.002, 0.02, 0.006, -0.004, 0.003]);
    let mut evaluate = |twist: [f64; 6]| {
        let pose = about(DVec3::ZERO, twist) * pose;
        icp.evaluate(&cast.fusion.view, 0, &pose, &cast.image, &Se3::IDENTITY, 0.2).unwrap()
    };
    let sums = evaluate([0.0; 6]);
    assert_eq!(sums.count, 60 * 45);
    let largest = sums.gradient.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
    for i in 0..6 {
        let h = 2e-3;
        let mut twist = [0.0; 6];
        twist[i] = h;
        let ahead = evaluate(twist).squares;
        twist[i] = -h;
        let slope = (ahead - evaluate(twist).squares) / (2.0 * h);
        // Of a sum of squares, half the slope is Jᵀr. The model's points and normals waver by a small part of a voxel from
        // pixel to pixel, and pairs change.
        assert!(
            (0.5 * slope - sums.gradient[i]).abs() < 0.02 * largest,
            "{i}: {} but {}",
            0.5 * slope,
            sums.gradient[i]
        );
    }
}

#[test]
fn two_casts_and_two_sums_give_the_same_bytes() {
    let Some(gpu) = common::gpu() else { return };
    let camera = common::camera(81, 61);
    let pose = common::poses()[1];
    let run = || {
        let cast = cast(gpu, &Scene::room(), &common::poses(), camera, pose);
        let sums =
            |level| Icp::new(&gpu.device).evaluate(&cast.fusion.view, level, &pose, &cast.image, &pose, 0.1).unwrap();
        (cast.image.read_ranges(&gpu.device).unwrap(), cast.points(gpu), cast.normals(gpu), [0, 1, 2].map(sums))
    };
    assert_eq!(run(), run());
}

#[test]
fn images_of_one_pixel_and_of_a_million_are_cast() {
    let Some(gpu) = common::gpu() else { return };
    let pose = common::poses()[0];
    for (width, height) in [(1, 1), (1280, 1024)] {
        let (w, h) = (f64::from(width), f64::from(height));
        let camera = Intrinsics::new(width, height, w, w, 0.5 * w - 0.5, 0.5 * h - 0.5);
        let cast = cast(gpu, &Scene::room(), &common::poses(), camera, pose);
        let points = to_reference(&cast.points(gpu));
        let middle = DVec2::new(f64::from(width / 2), f64::from(height / 2));
        let point = points[(width / 2, height / 2)].expect("the middle of the image shows the room");
        assert!(Scene::room().distance(point) < 0.5 * f64::from(VOXEL_M), "{point}");
        let pixel = camera.project(pose.inverse().transform_point(point)).unwrap();
        assert!(pixel.abs_diff_eq(middle, 1e-2), "{pixel}");
    }
}
