//! Stage `photometric` on the device, against its reference and against a painted room whose truth is known.

mod common;

use common::{Fusion, Gpu, Scene, Slack};
use glam::{DQuat, DVec3};
use itm_core::{Calibration, ColourImage, DepthConversion, DepthWeight, Distortion, Image, Intrinsics, Se3};
use itm_gpu::evaluate::{ColourTerm, Compared, Evaluator};
use itm_gpu::icp::DepthTerm;
use itm_gpu::photometric::{PhotometricTerm, PointList, REACH_M};
use itm_gpu::reference::photometric::{ColouredPoint, halve, map, photometric, previous};
use itm_gpu::{PhotometricSums, RaycastImage, Recorder, View};
use nalgebra::{Matrix6, Vector6};
use proptest::prelude::*;

const VOXEL_M: f32 = 0.03;
/// Positions of some metres are known up to a few roundings of 1.2e-7 m, and so is a place in an image of up to 120 pixels'
/// focal length, half a metre away or more, up to this.
const PIXEL: f64 = 2e-4;
/// Of a colour, half a step of its byte.
const BYTE: f64 = 0.5 / 255.0;

/// A painted room, fused with its colours from several poses and cast from another one, and a frame to align with it.
struct Painted {
    fusion: Fusion,
    model: RaycastImage,
    world_from_model: Se3,
    calibration: Calibration,
    view: View,
}

/// What tests vary.
#[derive(Clone, Copy, Debug)]
struct Sizes {
    model: (u32, u32),
    colour: (u32, u32),
    negative_fy: bool,
    /// Whether pixels without a colour are strewn over images.
    holes: bool,
}

const PLAIN: Sizes = Sizes { model: (100, 75), colour: (120, 90), negative_fy: false, holes: false };

impl Painted {
    fn new(gpu: &Gpu, sizes: Sizes, world_from_model: Se3, world_from_camera: Se3) -> Self {
        Self::fine(gpu, sizes, world_from_model, world_from_camera, (VOXEL_M, 4_000))
    }

    /// The same with voxels of a size, and room for so many blocks.
    fn fine(
        gpu: &Gpu,
        sizes: Sizes,
        world_from_model: Se3,
        world_from_camera: Se3,
        (voxel_m, blocks): (f32, u32),
    ) -> Self {
        let scene = Scene::room();
        let flip =
            |camera: Intrinsics| if sizes.negative_fy { Intrinsics { fy: -camera.fy, ..camera } } else { camera };
        let calibration = Calibration {
            depth: common::camera(100, 75),
            colour: flip(common::camera(sizes.colour.0, sizes.colour.1)),
            colour_from_depth: Se3::exp([0.03, -0.02, 0.01, 0.02, -0.01, 0.03]),
            depth_conversion: DepthConversion::MILLIMETRES,
            depth_distortion: Distortion::None,
            colour_distortion: Distortion::None,
        };
        let frame = |pose: &Se3| {
            let whole = scene.colour(&calibration.colour, &(*pose * calibration.colour_from_depth.inverse()));
            let colour = ColourImage::from_fn(whole.width(), whole.height(), |x, y| {
                let [r, g, b, a] = whole[(x, y)];
                [r, g, b, if sizes.holes && (7 * x + 13 * y) % 101 == 0 { 0 } else { a }]
            });
            common::frame(scene.depth(&calibration.depth, pose), Some(colour))
        };
        let mut fusion = Fusion::with_calibration(gpu, calibration, voxel_m, true, blocks);
        for pose in &common::poses() {
            fusion.fuse(gpu, &frame(pose), pose);
        }
        let model = fusion.cast(gpu, flip(common::camera(sizes.model.0, sizes.model.1)), &world_from_model);
        let view = gpu.see(&calibration, &frame(&world_from_camera));
        Self { fusion, model, world_from_model, calibration, view }
    }

    /// Where the colour camera is when the depth camera is at a pose.
    fn world_from_colour(&self, world_from_camera: &Se3) -> Se3 {
        *world_from_camera * self.calibration.colour_from_depth.inverse()
    }

    fn compared(&self) -> Compared<'_> {
        Compared { view: &self.view, level: 0, model: &self.model, world_from_model: self.world_from_model }
    }

    /// Points with the colours that a view shows.
    fn list_previous(&self, gpu: &Gpu, view: &View, pose: &Se3, levels: (usize, usize), least: f32) -> PointList {
        let list = PointList::new(&gpu.device, &self.model, levels.0, levels.1);
        let mut recorder = Recorder::new(&gpu.device);
        let evaluator = Evaluator::new(&gpu.device);
        let world_from_colour = self.world_from_colour(pose);
        evaluator.photometric.list_previous(&mut recorder, &list, &self.model, view, &world_from_colour, least);
        let _untimed = recorder.submit();
        list
    }

    /// Points with the map's colours.
    fn list_map(&self, gpu: &Gpu, levels: (usize, usize), least: f32) -> PointList {
        let list = PointList::new(&gpu.device, &self.model, levels.0, levels.1);
        let mut recorder = Recorder::new(&gpu.device);
        let evaluator = Evaluator::new(&gpu.device);
        let (map, pose) = (&self.fusion.map, &self.world_from_model);
        evaluator.photometric.list_map(&mut recorder, &list, &self.model, map, pose, least);
        let _untimed = recorder.submit();
        list
    }

    /// Every other one of the points with the map's colours.
    fn list_every_other(&self, gpu: &Gpu) -> PointList {
        let list = PointList::spaced(&gpu.device, &self.model, 0, 1, 2);
        let mut recorder = Recorder::new(&gpu.device);
        let evaluator = Evaluator::new(&gpu.device);
        let (map, pose) = (&self.fusion.map, &self.world_from_model);
        evaluator.photometric.list_map(&mut recorder, &list, &self.model, map, pose, 0.0);
        let _untimed = recorder.submit();
        list
    }

    /// The model's points that were observed often enough.
    fn points(&self, gpu: &Gpu, least: f32) -> Image<Option<DVec3>> {
        let points = self.model.read_points(&gpu.device).expect("the device answers");
        Image::from_fn(points.width(), points.height(), |x, y| {
            let [px, py, pz, observations_and_one] = points[(x, y)];
            (observations_and_one >= 1.0 + least).then(|| DVec3::new(px.into(), py.into(), pz.into()))
        })
    }

    /// A level of a list, as the references take it.
    fn read(&self, gpu: &Gpu, list: &PointList, level: usize) -> Image<Option<ColouredPoint>> {
        let camera = self.model.camera();
        let points = list.read(&gpu.device, level).expect("the device answers").into_iter().map(|point| {
            point.map(|(position, [r, g, b, _])| ColouredPoint {
                position: DVec3::from_array(position.map(f64::from)),
                colour: DVec3::from_array([r, g, b].map(|v| f64::from(v) / 255.0)),
            })
        });
        Image::new(camera.width.div_ceil(1 << level), camera.height.div_ceil(1 << level), points.collect())
            .expect("as many points as cells")
    }

    fn sums(&self, gpu: &Gpu, list: &PointList, pose: &Se3, term: PhotometricTerm) -> PhotometricSums {
        let term = ColourTerm { list, world_from_colour: self.world_from_colour(pose), term };
        let mut evaluator = Evaluator::new(&gpu.device);
        let found = evaluator.evaluate(&self.compared(), pose, None, [Some(&term), None]).expect("the device answers");
        let (None, [Some(sums), None]) = found else { panic!("sums that were not asked for, or none: {found:?}") };
        sums
    }
}

/// The four cameras whose principal points are off by the rounding of a place in the image.
fn shifted(camera: &Intrinsics) -> [Intrinsics; 4] {
    [(-PIXEL, -PIXEL), (PIXEL, -PIXEL), (-PIXEL, PIXEL), (PIXEL, PIXEL)].map(|(x, y)| Intrinsics {
        cx: camera.cx + x,
        cy: camera.cy + y,
        ..*camera
    })
}

/// Whether a list is one of several that it may be, point by point.
fn check_list(
    found: &Image<Option<ColouredPoint>>,
    candidates: &[Image<Option<ColouredPoint>>],
    (position_m, colour): (f64, f64),
) -> Result<(), TestCaseError> {
    for candidate in candidates {
        prop_assert_eq!(found.size(), candidate.size());
    }
    for (i, found) in found.data().iter().enumerate() {
        let same = |candidate: &Image<Option<ColouredPoint>>| match (found, &candidate.data()[i]) {
            (None, None) => true,
            (Some(a), Some(b)) => {
                a.position.abs_diff_eq(b.position, position_m) && a.colour.abs_diff_eq(b.colour, BYTE + colour)
            }
            _ => false,
        };
        prop_assert!(candidates.iter().any(same), "point {i}: {found:?} but {:?}", candidates[0].data()[i]);
    }
    Ok(())
}

fn size() -> impl Strategy<Value = (u32, u32)> {
    prop_oneof![Just((1, 1)), Just((81, 61)), Just((64, 48)), (1..100u32, 1..80u32)]
}

fn sizes() -> impl Strategy<Value = Sizes> {
    (size(), size(), any::<bool>(), any::<bool>()).prop_map(|(model, colour, negative_fy, holes)| Sizes {
        model,
        colour,
        negative_fy,
        holes,
    })
}

/// A pose near those that the room was fused from.
fn pose() -> impl Strategy<Value = Se3> {
    let (t, r) = (-0.1..0.1, -0.2..0.2);
    [t.clone(), t.clone(), t, r.clone(), r.clone(), r].prop_map(|twist| common::poses()[0] * Se3::exp(twist))
}

/// A small motion.
fn error() -> impl Strategy<Value = Se3> {
    [(); 6].map(|()| -0.02..0.02).prop_map(Se3::exp)
}

/// What counts in the colour term, and how much.
fn term() -> impl Strategy<Value = PhotometricTerm> {
    let weight = prop_oneof![Just(DepthWeight::None), Just(DepthWeight::Linear), Just(DepthWeight::Noise)];
    // Colours change by about this from pixel to pixel, by more at outlines.
    let gradient = prop_oneof![Just(0.0), 0.001..0.05f32];
    (0.02..1.5f32, 0.7..1.4f32, -0.1..0.1f32, gradient, weight, 1.5..4.0f32, 0..3usize, any::<bool>()).prop_map(
        |(cutoff, gain, offset, least_gradient, weight, far_m, level, rgb)| PhotometricTerm {
            cutoff,
            gain,
            offset,
            least_gradient,
            weight,
            depth_range_m: [0.5, far_m],
            level,
            rgb,
        },
    )
}

proptest! {
    #![proptest_config(common::cases(20))]

    #[test]
    fn lists_with_colours_of_the_frame_before_are_the_references(
        sizes in sizes(), model in pose(), before in pose(), finest in 0..3usize, least in 0..4u8,
    ) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let painted = Painted::new(gpu, sizes, model, before);
        let list = painted.list_previous(gpu, &painted.view, &before, (finest, finest + 1), least.into());
        let image = painted.view.read_colour(&gpu.device, finest).unwrap().expect("the frame has colour");
        let camera = painted.calibration.colour.at_level(finest as u32);
        let points = painted.points(gpu, least.into());
        let pose = painted.world_from_colour(&before);
        // Rounding decides whether a place lies in the image, and which pixels are the ones around.
        let candidates: Vec<_> = std::iter::once(camera)
            .chain(shifted(&camera))
            .map(|camera| previous(&points, 1 << finest, &image, &camera, &pose))
            .collect();
        // The positions are the same numbers; colours change by at most 1 from pixel to pixel.
        check_list(&painted.read(gpu, &list, finest), &candidates, (0.0, PIXEL))?;
    }

    #[test]
    fn lists_with_colours_of_the_map_are_the_references(
        sizes in sizes(), model in pose(), finest in 0..3usize, least in 0..4u8,
    ) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let painted = Painted::new(gpu, sizes, model, model);
        let list = painted.list_map(gpu, (finest, finest + 1), least.into());
        let fused = painted.fusion.read();
        // Positions of some metres in voxels are known up to a few roundings. That decides which voxels are the ones around,
        // and how much each counts where those with a colour are furthest away.
        let shares: Vec<_> = (0..9)
            .map(|corner| {
                let off = |axis: u32| if (corner >> axis) & 1 == 1 { 1e-6 } else { -1e-6 };
                let shift = if corner == 8 { DVec3::ZERO } else { DVec3::new(off(0), off(1), off(2)) };
                let points = painted.points(gpu, least.into());
                let moved = Image::from_fn(points.width(), points.height(), |x, y| points[(x, y)].map(|p| p + shift));
                map(&moved, 1 << finest, &fused)
            })
            .collect();
        let found = painted.read(gpu, &list, finest);
        prop_assert!(shares.iter().all(|share| share.size() == found.size()));
        for (i, found) in found.data().iter().enumerate() {
            let expected: Vec<_> = shares.iter().map(|share| share.data()[i]).collect();
            let Some(found) = found else {
                prop_assert!(expected.contains(&None), "point {i}: none, but {expected:?}");
                continue;
            };
            let (mut least, mut most) = (DVec3::MAX, DVec3::MIN);
            for expected in expected.iter().flatten() {
                (least, most) = (least.min(expected.colour), most.max(expected.colour));
                prop_assert!(found.position.abs_diff_eq(expected.position, 2e-6));
            }
            // Beside the byte's, roundings of a mean of eight.
            let slack = BYTE + 1e-5;
            let inside = found.colour.cmpge(least - slack).all() && found.colour.cmple(most + slack).all();
            prop_assert!(inside, "point {i}: {found:?} but {expected:?}");
        }
    }

    #[test]
    fn coarser_lists_are_the_references(sizes in sizes(), model in pose(), finest in 0..2usize, of_map: bool) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let painted = Painted::new(gpu, sizes, model, common::poses()[2]);
        let levels = (finest, finest + 3);
        let (list, camera) = if of_map {
            (painted.list_map(gpu, levels, 0.0), model)
        } else {
            let before = common::poses()[2];
            (painted.list_previous(gpu, &painted.view, &before, levels, 0.0), painted.world_from_colour(&before))
        };
        for coarse in 1..3 {
            let fine = painted.read(gpu, &list, finest + coarse - 1);
            let reach = f64::from(REACH_M) * f64::from(1 << (coarse - 1));
            // Rounding decides whether a point is near enough to the first one.
            let candidates = [0.0, -1e-6, 1e-6].map(|margin| halve(&fine, reach + margin, camera.translation));
            // Four positions of some metres are added up.
            check_list(&painted.read(gpu, &list, finest + coarse), &candidates, (1e-6, 1e-5))?;
        }
    }

    #[test]
    fn the_sums_of_photometric_are_the_references(
        sizes in sizes(), model in pose(), error in error(), term in term(), of_map: bool, finest in 0..2usize,
    ) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let live = common::poses()[2];
        let painted = Painted::new(gpu, sizes, model, live);
        let levels = (finest, finest + 2);
        let list = if of_map {
            painted.list_map(gpu, levels, 0.0)
        } else {
            painted.list_previous(gpu, &painted.view, &live, levels, 0.0)
        };
        let guess = live * error;
        let found = painted.sums(gpu, &list, &guess, term);

        let points = painted.read(gpu, &list, term.level.clamp(levels.0, levels.1 - 1));
        let image = painted.view.read_colour(&gpu.device, term.level).unwrap().expect("the frame has colour");
        let camera = painted.calibration.colour.at_level(term.level as u32);
        let (pose, pivot) = (painted.world_from_colour(&guess), model.translation);
        let expected = photometric(points.data(), &image, &camera, &pose, pivot, &term);
        let slack = slack(points.data(), &image, &camera, &pose, pivot, &term);
        slack.check(&numbers(&found), &numbers(&expected))?;
        prop_assert_eq!(found.valid as usize, points.data().iter().flatten().count());
    }
}

/// All sums in one list.
fn numbers(sums: &PhotometricSums) -> Vec<f64> {
    let PhotometricSums { hessian, gradient, cost, weights, unseen, squares, count, valid } = sums;
    let mut numbers = [hessian.as_flattened(), gradient].concat();
    numbers.extend([cost, weights, unseen, squares]);
    numbers.extend([count, valid].map(|n| f64::from(*n)));
    numbers
}

/// How far single precision may take the sums away from the reference's.
fn slack(
    points: &[Option<ColouredPoint>],
    image: &ColourImage,
    camera: &Intrinsics,
    world_from_colour: &Se3,
    pivot: DVec3,
    term: &PhotometricTerm,
) -> Slack {
    // Differences between numbers of about 1 are known up to a few roundings of 6e-8.
    const VALUE: f64 = 1e-6;
    // Between pixels the image bends, and at its border it ends; differences may be just below or above the cutoff, changes
    // just below or above the least one, a depth just inside of its range or outside: the reference is asked for what would
    // come of either.
    let shifted = shifted(camera);
    let terms: Vec<PhotometricTerm> = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0_f32)]
        .into_iter()
        .map(|(a, b)| PhotometricTerm {
            cutoff: term.cutoff + 2.0 * a * VALUE as f32,
            depth_range_m: [term.depth_range_m[0], term.depth_range_m[1] + 1e-5 * a],
            least_gradient: term.least_gradient + b * VALUE as f32,
            ..*term
        })
        .collect();
    let cutoff = f64::from(term.cutoff);
    let channels = if term.rgb { 3.0 } else { 1.0 };
    let mut slack = Slack::new(numbers(&PhotometricSums::default()).len());
    for point in points.iter().flatten() {
        let alone = |camera: &Intrinsics, term: &PhotometricTerm| {
            photometric(&[Some(*point)], image, camera, world_from_colour, pivot, term)
        };
        let sums = alone(camera, term);
        let perhaps = shifted.iter().flat_map(|camera| terms.iter().map(move |term| numbers(&alone(camera, term))));
        slack.may_be(&numbers(&sums), perhaps);

        // Roundings are relative to the lengths of vectors, not to their components.
        let h = &sums.hessian;
        let t = (h[0][0] + h[1][1] + h[2][2]).sqrt();
        let r = t * point.position.distance(pivot);
        let size = [t, t, t, r, r, r, h[6][6].sqrt(), h[7][7].sqrt()];
        let (residual, weight) = (sums.squares.sqrt(), (h[7][7] / channels).sqrt());
        // The weight (1 - r²/c²)² changes by less than 3/c for its part where r is less than half of c; beyond, the cutoffs
        // above cover it.
        let share = Slack::SHARE + 3.0 * VALUE / cutoff;
        let mut rounding: Vec<f64> = size.iter().flat_map(|a| size.map(|b| share * a * b)).collect();
        rounding.extend(size.map(|size| size * weight * (share * residual + channels.sqrt() * VALUE)));
        rounding.extend([
            // c²/6 (1 - (1 - r²/c²)³) has the roundings of numbers of about 1.
            Slack::SHARE * sums.cost + sums.weights * (residual + cutoff * cutoff / 6.0) * VALUE,
            Slack::SHARE * sums.weights,
            Slack::SHARE * sums.unseen,
            Slack::SHARE * sums.squares + 2.0 * channels.sqrt() * residual * VALUE,
        ]);
        slack.add(&rounding);
    }
    slack
}

/// Everything counts that is less than a cutoff off.
fn plain(rgb: bool) -> PhotometricTerm {
    PhotometricTerm {
        cutoff: 0.5,
        gain: 1.0,
        offset: 0.0,
        least_gradient: 0.0,
        weight: DepthWeight::None,
        depth_range_m: [0.0, 1.0],
        level: 0,
        rgb,
    }
}

#[test]
fn terms_are_summed_together_as_alone_and_not_without_colour() {
    let Some(gpu) = common::gpu() else { return };
    let pose = common::poses()[0];
    let painted = Painted::new(gpu, PLAIN, pose, common::poses()[2]);
    let lists = [
        painted.list_previous(gpu, &painted.view, &common::poses()[2], (0, 2), 0.0),
        painted.list_map(gpu, (1, 3), 0.0),
    ];
    let guess = common::poses()[2] * Se3::exp([0.01, -0.01, 0.005, 0.01, 0.0, -0.01]);
    let world_from_colour = painted.world_from_colour(&guess);
    let terms = [
        ColourTerm { list: &lists[0], world_from_colour, term: plain(false) },
        ColourTerm { list: &lists[1], world_from_colour, term: PhotometricTerm { level: 1, ..plain(true) } },
    ];
    let [first, second] = terms.each_ref().map(Some);
    let depth = DepthTerm { huber_m: 0.01, weight: DepthWeight::Noise, ..DepthTerm::plain(0.1) };
    let mut evaluator = Evaluator::new(&gpu.device);
    let mut evaluate = |view: &View, depth: Option<&DepthTerm>, colour: [Option<&ColourTerm<'_>>; 2]| {
        let compared = Compared { view, ..painted.compared() };
        evaluator.evaluate(&compared, &guess, depth, colour).expect("the device answers")
    };

    let together = evaluate(&painted.view, Some(&depth), [first, second]);
    let (Some(of_depth), [Some(of_first), Some(of_second)]) = together else {
        panic!("terms are missing: {together:?}")
    };
    assert!(of_depth.count > 1000 && of_first.count > 1000 && of_second.count > 1000, "{together:?}");
    assert_eq!(evaluate(&painted.view, Some(&depth), [None, None]), (Some(of_depth), [None, None]));
    assert_eq!(evaluate(&painted.view, None, [first, None]), (None, [Some(of_first), None]));
    assert_eq!(evaluate(&painted.view, None, [None, second]), (None, [None, Some(of_second)]));
    assert_eq!(evaluate(&painted.view, None, [second, first]), (None, [Some(of_second), Some(of_first)]));
    assert_eq!(evaluate(&painted.view, Some(&depth), [first, second]), together);

    let depth_camera = painted.calibration.depth;
    let frame = common::frame(Scene::room().depth(&depth_camera, &common::poses()[2]), None);
    let without = gpu.see(&painted.calibration, &frame);
    assert_eq!(evaluate(&without, Some(&depth), [first, second]), (Some(of_depth), [None, None]));
    assert_eq!(evaluate(&without, None, [None, None]), (None, [None, None]));
}

#[test]
fn every_other_point_of_a_list_is_what_the_next_level_has() {
    let Some(gpu) = common::gpu() else { return };
    let painted = Painted::new(gpu, PLAIN, common::poses()[0], common::poses()[2]);
    let read = |list: PointList, level| list.read(&gpu.device, level).expect("the device answers");
    let points = read(painted.list_every_other(gpu), 0);
    assert!(points.iter().flatten().count() > 100);
    assert!(points == read(painted.list_map(gpu, (1, 2), 0.0), 1));
    assert!(points.len() < read(painted.list_map(gpu, (0, 1), 0.0), 0).len());
}

#[test]
fn a_list_from_a_map_in_several_pages_is_the_same_list() {
    let Some(gpu) = common::gpu() else { return };
    // 8192 blocks a page.
    let paged = Gpu::new(&common::device_with_bindings_of(16 << 20));
    let camera = common::camera(160, 120);
    let poses: Vec<Se3> = (0..4).map(|i| Se3::exp([0.0, 0.0, 0.0, 0.0, 1.6 * f64::from(i), 0.0])).collect();
    let run = |gpu: &Gpu| {
        let mut fusion = Fusion::new(gpu, camera, 0.005, true, 20_000);
        for pose in &poses {
            let scene = Scene::room();
            fusion.fuse(gpu, &common::frame(scene.depth(&camera, pose), Some(scene.colour(&camera, pose))), pose);
        }
        let blocks = fusion.keys().len();
        let lists = poses.iter().map(|pose| {
            let model = fusion.cast(gpu, camera, pose);
            let list = PointList::new(&gpu.device, &model, 0, 2);
            let mut recorder = Recorder::new(&gpu.device);
            let evaluator = Evaluator::new(&gpu.device);
            evaluator.photometric.list_map(&mut recorder, &list, &model, &fusion.map, pose, 0.0);
            let _untimed = recorder.submit();
            [0, 1].map(|level| list.read(&gpu.device, level).expect("the device answers"))
        });
        (blocks, lists.collect::<Vec<_>>())
    };
    let (one, several) = (run(gpu), run(&paged));
    assert!(one.0 > 8_192, "only {} blocks, which fit one page", one.0);
    assert!(one.1.iter().all(|lists| lists[0].iter().flatten().count() > 1000));
    assert!(one == several);
}

/// A motion about a pivot, as the sums mean it.
fn about(pivot: DVec3, twist: [f64; 6]) -> Se3 {
    let to_pivot = Se3::new(DQuat::IDENTITY, pivot);
    to_pivot * Se3::exp(twist) * to_pivot.inverse()
}

/// The step of the pose that a Gauss-Newton iteration takes.
fn step(sums: &PhotometricSums) -> [f64; 6] {
    let hessian = Matrix6::from_fn(|r, c| sums.hessian[r][c]);
    let gradient = Vector6::from_fn(|r, _| sums.gradient[r]);
    (-hessian.cholesky().expect("the room fixes all six directions").solve(&gradient)).into()
}

/// Errors that are a centimetre and half a degree long.
fn errors() -> Vec<[f64; 6]> {
    let (cm, turn) = (0.01 / 3.0_f64.sqrt(), 0.5_f64.to_radians() / 3.0_f64.sqrt());
    vec![
        [0.01, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.5_f64.to_radians(), 0.0],
        [cm, -cm, cm, turn, turn, -turn],
        [-cm, cm, cm, -turn, turn, turn],
    ]
}

#[test]
fn steps_lead_back_to_the_true_pose() {
    let Some(gpu) = common::gpu() else { return };
    let (before, truth) = (common::poses()[0], common::poses()[0] * Se3::exp([0.03, 0.01, -0.02, 0.01, 0.03, -0.02]));
    let painted = Painted::fine(gpu, PLAIN, before, truth, (0.015, 20_000));
    let seen_before = Painted::new(gpu, PLAIN, before, before).view;
    let lists = [
        ("the frame before", painted.list_previous(gpu, &seen_before, &before, (0, 1), 0.0)),
        ("the map", painted.list_map(gpu, (0, 1), 0.0)),
    ];
    for ((against, list), rgb) in lists.iter().flat_map(|list| [(list, false), (list, true)]) {
        let context = format!("against {against}, {}", if rgb { "three colours" } else { "intensity" });
        // What only one of the cameras sees differs by anything; all else by much less than this, once it is aligned.
        let strict = PhotometricTerm { cutoff: 0.05, ..plain(rgb) };
        let wide = PhotometricTerm { cutoff: 0.5, ..plain(rgb) };
        let evaluate = |pose: &Se3, term| painted.sums(gpu, list, pose, term);
        let stepped = |pose: &Se3, term| about(before.translation, step(&evaluate(pose, term))) * *pose;

        let sums = evaluate(&truth, strict);
        assert!(sums.count * 10 > sums.valid * 8, "{context}: {} of {} points", sums.count, sums.valid);
        let rms = (sums.squares / f64::from(sums.count)).sqrt();
        // Two or three steps of a byte, which is what colours and the model's places, a part of a voxel off, leave.
        assert!(rms < 0.01, "{context}: the colours differ by {rms}");
        let least = evaluate(&truth, wide).cost;
        for error in errors() {
            let start = about(before.translation, error) * truth;
            let mut pose = stepped(&start, wide);
            let [from, to] = [start, pose].map(|pose| evaluate(&pose, wide).cost - least);
            assert!(to < 0.1 * from, "{context}: a step from {error:?} lowers the cost from {from} to {to}");
            for term in [wide, wide, wide, strict, strict, strict] {
                pose = stepped(&pose, term);
            }
            let left = truth.inverse() * pose;
            let (metres, degrees) = (left.translation.length(), left.angle().to_degrees());
            assert!(
                metres < 1e-3 && degrees < 0.05,
                "{context}: of {error:?} {metres} m and {degrees} degrees are left"
            );
        }
    }
}
