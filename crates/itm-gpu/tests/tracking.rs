//! Stages `ranges`, `raycast`, `normals` and `icp` on the device, against their references and against scenes whose truth
//! is known.

mod common;

use std::f64::consts::PI;

use common::{Fusion, Gpu, RANGE_M, Scene, Shape, Slack, quantile, to_reference};
use glam::{DVec2, DVec3, IVec3};
use itm_core::{DepthWeight, Image, Intrinsics, Se3};
use itm_gpu::evaluate::{Compared, Evaluator};
use itm_gpu::icp::DepthTerm;
use itm_gpu::{DepthSums, RaycastImage, View, reference};
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
    fn the_sums_of_icp_are_the_references(
        size in size(), depth_size in size(), pose in pose(), error in pose(), level in 0..3usize, term in term(),
        negative_fy: (bool, bool),
    ) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let flip = |camera: Intrinsics, flip| if flip { Intrinsics { fy: -camera.fy, ..camera } } else { camera };
        let camera = flip(common::camera(size.0, size.1), negative_fy.0);
        let cast = cast(gpu, &Scene::room(), &common::poses(), camera, pose);
        // The frame to align: the third pose's, taken to be somewhere near it.
        let guess = common::poses()[2] * Se3::exp(error.log().map(|v| 0.05 * v));
        let depth_camera = flip(common::camera(depth_size.0, depth_size.1), negative_fy.1);
        let calibration = common::one_camera(depth_camera);
        let view = gpu.see(&calibration, &common::frame(Scene::room().depth(&depth_camera, &common::poses()[2]), None));
        let found = sums(gpu, &cast, &view, level, &guess, &term);

        let model = model(&cast, gpu);
        let depth = view.read_depth(&gpu.device, level).unwrap();
        let level_camera = view.level_camera(level);
        let expected = reference::icp::icp(&model, &depth, level_camera, &guess, &term);
        let slack = icp_slack(&model, &depth, level_camera, &guess, &term);
        slack.check(&numbers(&found), &numbers(&expected))?;
        prop_assert!(found.in_front + found.behind + found.count <= found.valid, "{found:?}");
    }
}

/// What counts in the depth term, and how much.
fn term() -> impl Strategy<Value = DepthTerm> {
    let limits = (
        0.01..0.2f32,
        prop_oneof![Just(f32::MAX), 0.001..0.1f32],
        prop_oneof![Just(f32::MAX), Just(f32::INFINITY), 0.0005..0.05f32],
    );
    let weight = prop_oneof![Just(DepthWeight::None), Just(DepthWeight::Linear), Just(DepthWeight::Noise)];
    // Points were observed up to three times, and depths reach beyond the nearer of the ranges.
    let confidence = (prop_oneof![Just(0.0f32), (1..6u8).prop_map(f32::from)], (0..4u8).prop_map(f32::from));
    (limits, weight, 1.5..4.0f32, confidence, 1..4u32).prop_map(|(limits, weight, far_m, confidence, stride)| {
        DepthTerm {
            max_distance_m: limits.0,
            max_plane_distance_m: limits.1,
            huber_m: limits.2,
            weight,
            depth_range_m: [0.5, far_m],
            full_confidence: confidence.0,
            least_confidence: confidence.1,
            stride,
        }
    })
}

fn sums(gpu: &Gpu, cast: &Cast, view: &View, level: usize, pose: &Se3, term: &DepthTerm) -> DepthSums {
    let compared = Compared { view, level, model: &cast.image, world_from_model: cast.pose };
    let mut evaluator = Evaluator::new(&gpu.device);
    let (depth, colour) = evaluator.evaluate(&compared, pose, Some(term), [None, None]).expect("the device answers");
    assert_eq!(colour, [None; 2]);
    depth.expect("it was asked for")
}

fn model(cast: &Cast, gpu: &Gpu) -> reference::icp::Model {
    let points = cast.points(gpu);
    reference::icp::Model {
        // The fourth number is one more than the observations.
        observations: Image::from_fn(points.width(), points.height(), |x, y| {
            (points[(x, y)][3] as u16).saturating_sub(1)
        }),
        points: to_reference(&points),
        normals: to_reference(&cast.normals(gpu)),
        camera: cast.camera,
        world_from_camera: cast.pose,
    }
}

/// All sums in one list.
fn numbers(sums: &DepthSums) -> Vec<f64> {
    let DepthSums { hessian, gradient, cost, weights, apart, squares, count, valid, in_front, behind, unseen } = sums;
    let mut numbers = [hessian.as_flattened(), gradient].concat();
    numbers.extend([cost, weights, apart, squares, unseen]);
    numbers.extend([count, valid, in_front, behind].map(|n| f64::from(*n)));
    numbers
}

/// How far single precision may take the sums away from the reference's.
fn icp_slack(
    model: &reference::icp::Model,
    depth: &Image<f32>,
    camera: &Intrinsics,
    guess: &Se3,
    term: &DepthTerm,
) -> Slack {
    // Positions of some metres are known up to a few roundings of 2.4e-7 m.
    const POSITION_M: f64 = 2e-6;
    // A place in the model's image, of up to 100 pixels' focal length, half a metre away or more, is known up to this.
    const PIXEL: f64 = 1e-3;
    // Where rounding decides which pixel of the model is the nearest, whether it is near enough, or on which side of the
    // surface a point lies, the reference is asked for what would come of either.
    let shifted: Vec<reference::icp::Model> = [(-PIXEL, -PIXEL), (PIXEL, -PIXEL), (-PIXEL, PIXEL), (PIXEL, PIXEL)]
        .into_iter()
        .map(|(x, y)| {
            let mut model = model.clone();
            (model.camera.cx, model.camera.cy) = (model.camera.cx + x, model.camera.cy + y);
            model
        })
        .collect();
    let limits = [-1e-5, 1e-5].map(|m: f32| DepthTerm {
        max_distance_m: term.max_distance_m + m,
        max_plane_distance_m: (term.max_plane_distance_m + m).max(0.0),
        ..*term
    });
    let pivot = model.world_from_camera.translation;
    let mut slack = Slack::new(numbers(&DepthSums::default()).len());
    for y in (0..depth.height()).step_by(term.stride as usize) {
        for x in (0..depth.width()).step_by(term.stride as usize) {
            let z = depth[(x, y)];
            if z <= 0.0 {
                continue;
            }
            let pixel_camera = Intrinsics {
                cx: camera.cx - f64::from(x),
                cy: camera.cy - f64::from(y),
                width: 1,
                height: 1,
                ..*camera
            };
            let alone = |model: &reference::icp::Model, z: f32, term: &DepthTerm| {
                let pixel = Image::filled(1, 1, z);
                reference::icp::icp(model, &pixel, &pixel_camera, guess, &DepthTerm { stride: 1, ..*term })
            };
            let sums = alone(model, z, term);
            let perhaps = shifted.iter().flat_map(|model| {
                let near_and_far = [z - POSITION_M as f32, z + POSITION_M as f32];
                near_and_far.into_iter().flat_map(move |z| limits.map(|term| numbers(&alone(model, z, &term))))
            });
            slack.may_be(&numbers(&sums), perhaps);

            // The residual and its derivatives are uncertain by the roundings of the positions.
            let world = guess.transform_point(camera.unproject(DVec2::new(x.into(), y.into()), z.into()));
            let arm = world.distance(pivot);
            let size = [1.0, 1.0, 1.0, arm, arm, arm].map(|size: f64| size * sums.weights.sqrt());
            let residual = sums.squares.sqrt();
            let mut rounding: Vec<f64> = size
                .iter()
                .flat_map(|a| size.map(|b| (Slack::SHARE + POSITION_M / residual.max(term.huber_m.into())) * a * b))
                .collect();
            rounding.extend(size.map(|size| size * sums.weights.sqrt() * (Slack::SHARE * residual + POSITION_M)));
            rounding.extend([
                Slack::SHARE * sums.cost + sums.weights * residual * POSITION_M,
                Slack::SHARE * sums.weights,
                Slack::SHARE * sums.apart,
                Slack::SHARE * sums.squares + 2.0 * residual * POSITION_M,
                Slack::SHARE * sums.unseen,
            ]);
            slack.add(&rounding);
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
fn step(sums: &DepthSums) -> [f64; 6] {
    let hessian = Matrix6::from_fn(|i, j| sums.hessian[i][j]);
    let gradient = Vector6::from_fn(|i, _| sums.gradient[i]);
    (-hessian.cholesky().expect("the room fixes all six directions").solve(&gradient)).into()
}

/// A motion about a pivot, as `DepthSums` means it.
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
    for huber_m in [f32::INFINITY, 0.01] {
        comes_back(gpu, &cast, &DepthTerm { huber_m, ..DepthTerm::plain(0.1) });
    }
}

fn comes_back(gpu: &Gpu, cast: &Cast, term: &DepthTerm) {
    let truth = cast.pose;
    let evaluate = |pose: &Se3, level| sums(gpu, cast, &cast.fusion.view, level, pose, term);
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
fn the_gradient_of_icp_is_the_slope_of_its_cost() {
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
    let pose = Se3::exp([0.004, 0.002, 0.02, 0.006, -0.004, 0.003]);
    // Some residuals below Huber's limit, some above.
    for huber_m in [f32::INFINITY, 0.02] {
        let term = DepthTerm { huber_m, ..DepthTerm::plain(0.2) };
        let evaluate =
            |twist: [f64; 6]| sums(gpu, &cast, &cast.fusion.view, 0, &(about(DVec3::ZERO, twist) * pose), &term);
        is_its_slope(evaluate);
    }
}

fn is_its_slope(evaluate: impl Fn([f64; 6]) -> DepthSums) {
    let sums = evaluate([0.0; 6]);
    assert_eq!(sums.count, 60 * 45);
    let largest = sums.gradient.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
    for i in 0..6 {
        let h = 2e-3;
        let mut twist = [0.0; 6];
        twist[i] = h;
        let ahead = evaluate(twist).cost;
        twist[i] = -h;
        let slope = (ahead - evaluate(twist).cost) / (2.0 * h);
        // The model's points and normals waver by a small part of a voxel from pixel to pixel, and pairs change.
        assert!((slope - sums.gradient[i]).abs() < 0.02 * largest, "{i}: {slope} but {}", sums.gradient[i]);
    }
}

#[test]
fn two_casts_and_two_sums_give_the_same_bytes() {
    let Some(gpu) = common::gpu() else { return };
    let camera = common::camera(81, 61);
    let pose = common::poses()[1];
    let run = || {
        let cast = cast(gpu, &Scene::room(), &common::poses(), camera, pose);
        let sums = |level| sums(gpu, &cast, &cast.fusion.view, level, &pose, &DepthTerm::plain(0.1));
        (cast.image.read_ranges(&gpu.device).unwrap(), cast.points(gpu), cast.normals(gpu), [0, 1, 2].map(sums))
    };
    assert_eq!(run(), run());
}

#[test]
fn sums_at_many_poses_are_those_at_each() {
    let Some(gpu) = common::gpu() else { return };
    let cast = cast(gpu, &Scene::room(), &common::poses(), common::camera(81, 61), common::poses()[1]);
    let term = DepthTerm::plain(0.1);
    // More than are read at once.
    let poses: Vec<Se3> = (0..19)
        .map(|i| cast.pose * Se3::exp([0.004, 0.0, -0.003, 0.0, 0.005, 0.0].map(|v| v * f64::from(i))))
        .collect();
    let compared = Compared { view: &cast.fusion.view, level: 1, model: &cast.image, world_from_model: cast.pose };
    let mut evaluator = Evaluator::new(&gpu.device);
    for count in [0, 1, 16, 19] {
        let found = evaluator.evaluate_at(&compared, &poses[..count], &term).expect("the device answers");
        let each = poses[..count].iter().map(|pose| sums(gpu, &cast, &cast.fusion.view, 1, pose, &term));
        assert_eq!(found, each.collect::<Vec<_>>());
    }
    // The reference's, too.
    let found = evaluator.evaluate_at(&compared, &poses, &term).expect("the device answers");
    let (model, depth) = (model(&cast, gpu), cast.fusion.view.read_depth(&gpu.device, 1).expect("the device answers"));
    let camera = cast.fusion.view.level_camera(1);
    for (found, pose) in found.iter().zip(&poses) {
        let expected = reference::icp::icp(&model, &depth, camera, pose, &term);
        let slack = icp_slack(&model, &depth, camera, pose, &term);
        slack.check(&numbers(found), &numbers(&expected)).expect("within the roundings");
    }
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
