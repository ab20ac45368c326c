//! Stages `associate`, `segment`, `absorb` and `splat` on the device, against their references and against scenes whose truth is known.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

mod common;

use std::sync::OnceLock;

use common::{Gpu, RANGE_M, Scene, Shape, VIEW_OPTIONS, to_reference};
use glam::{DVec2, DVec3, IVec2, UVec2};
use itm_core::surfel::{SURFEL_WORDS, Surfel, confidence_rank};
use itm_core::voxel::ColourVoxel;
use itm_core::{Calibration, ColourImage, DepthConversion, Image, Intrinsics, Se3, SurfelSettings};
use itm_gpu::absorb::Absorb;
use itm_gpu::associate::Associate;
use itm_gpu::evaluate::Evaluator;
use itm_gpu::photometric::PointList;
use itm_gpu::reference::absorb as to_absorb;
use itm_gpu::reference::associate::{Association, Measured, Role};
use itm_gpu::reference::segment::Known;
use itm_gpu::reference::splat::Look;
use itm_gpu::segment::Segment;
use itm_gpu::splat::{Drawn, Splat};
use itm_gpu::view::ViewOptions;
use itm_gpu::{
    Device, Part, RaycastImage, Recorder, Segmentation, SurfelMap, SurfelOptions, SurfelRecord, SurfelView, View,
    reference,
};
use proptest::prelude::*;

type Words = [u32; SURFEL_WORDS];

/// Where numbers that decide lie this near to a border (in metres; as cosines), single precision may decide otherwise: places carry a
/// few roundings of 2.4e-7 m each.
const MARGIN_M: f64 = 1e-5;
/// Centres that lie so many pixels from a cell's border may be found in the next one.
const MARGIN_PX: f64 = 1e-3;
/// Places are right to so many metres.
const PLACE_M: f64 = 5e-6;
/// Normals are kept in 16 bits a coordinate; where the mean of two nearly opposite ones is taken, more is lost.
const NORMAL: f32 = 3e-4;
/// Radii are kept to this share of them.
const RADIUS: f32 = 4e-4;

/// All surfels alike.
const ALL: Drawn = Drawn { least: 0.0, preferred: 0.0, since: 0, reach: 1.0, fill: 3.0 };

/// The stages, compiled once for a device.
struct Stages {
    associate: Associate,
    absorb: Absorb,
    splat: Splat,
    segment: Segment,
}

impl Stages {
    fn new(device: &Device) -> Self {
        Self {
            associate: Associate::new(device),
            absorb: Absorb::new(device),
            splat: Splat::new(device),
            segment: Segment::new(device),
        }
    }
}

fn gpu() -> Option<(&'static Gpu, &'static Stages)> {
    static STAGES: OnceLock<Stages> = OnceLock::new();
    common::gpu().map(|gpu| (gpu, STAGES.get_or_init(|| Stages::new(&gpu.device))))
}

/// A map and what fills it.
struct Fusion<'a> {
    gpu: &'a Gpu,
    stages: &'a Stages,
    map: SurfelMap,
    view: View,
    pixels: SurfelView,
    calibration: Calibration,
    view_options: ViewOptions,
    settings: SurfelSettings,
    frame: u32,
}

impl<'a> Fusion<'a> {
    fn new((gpu, stages): (&'a Gpu, &'a Stages), calibration: Calibration, capacity: u32) -> Self {
        let view_options = ViewOptions { vertices: Some(1), ..VIEW_OPTIONS };
        Self {
            gpu,
            stages,
            map: SurfelMap::new(&gpu.device, capacity).unwrap(),
            view: View::new(&gpu.device, &calibration, &view_options),
            pixels: SurfelView::new(&gpu.device, calibration.depth),
            calibration,
            view_options,
            settings: SurfelSettings::default(),
            frame: 0,
        }
    }

    /// Takes a frame over.
    fn see(&mut self, depth: Image<f32>, colour: Option<ColourImage>) {
        let mut recorder = Recorder::new(&self.gpu.device);
        let frame = common::frame(depth, colour);
        self.gpu.view.record(&mut recorder, &mut self.view, &frame, &self.view_options).unwrap();
        let _untimed = recorder.submit();
        self.frame += 1;
    }

    /// Finds the free slots.
    fn find_free(&self) {
        let mut recorder = Recorder::new(&self.gpu.device);
        self.stages.absorb.record_free(&mut recorder, &self.map, &self.pixels);
        let _untimed = recorder.submit();
    }

    fn options<'b>(&'b self, world_from_camera: &'b Se3) -> SurfelOptions<'b> {
        SurfelOptions {
            world_from_camera,
            settings: &self.settings,
            depth_range_m: RANGE_M,
            frame: self.frame,
            part: Part::Whole,
        }
    }

    /// Fuses what was seen last.
    fn fuse(&self, pose: &Se3) -> SurfelRecord {
        let options = self.options(pose);
        let mut recorder = Recorder::new(&self.gpu.device);
        let (associate, absorb) = (&self.stages.associate, &self.stages.absorb);
        associate.record(&mut recorder, &self.map, &self.view, &self.pixels, &self.calibration, &options);
        absorb.record(&mut recorder, &self.map, &self.view, &self.pixels, &options);
        let reader = self.map.record_counters(&mut recorder);
        let _untimed = recorder.submit();
        reader.read(&self.gpu.device).unwrap()
    }

    /// Points, normals and colours of the map as seen from a pose.
    fn splat(&self, camera: Intrinsics, pose: &Se3, drawn: Drawn) -> (Image<[f32; 4]>, Image<[f32; 4]>, ColourImage) {
        let device = &self.gpu.device;
        let image = RaycastImage::new(device, camera).unwrap();
        let pixels = SurfelView::new(device, camera);
        let mut recorder = Recorder::new(device);
        self.stages.splat.record(&mut recorder, &self.map, &pixels, &image, &self.options(pose), drawn);
        let _untimed = recorder.submit();
        let colours = pixels.read_colours(device).unwrap();
        (image.read_points(device).unwrap(), image.read_normals(device).unwrap(), colours)
    }

    /// The same from the pose that was fused last, with the list that is there.
    fn splat_listed(&self, pose: &Se3, drawn: Drawn) -> (Image<[f32; 4]>, Image<[f32; 4]>, ColourImage) {
        let device = &self.gpu.device;
        let image = RaycastImage::new(device, self.calibration.depth).unwrap();
        let mut recorder = Recorder::new(device);
        let (splat, options) = (&self.stages.splat, self.options(pose));
        splat.record_listed(&mut recorder, &self.map, &self.pixels, &image, &options, drawn);
        let _untimed = recorder.submit();
        let colours = self.pixels.read_colours(device).unwrap();
        (image.read_points(device).unwrap(), image.read_normals(device).unwrap(), colours)
    }

    fn words(&self) -> Vec<Words> {
        self.map.read_words().unwrap()
    }

    fn surfels(&self) -> Vec<Surfel> {
        self.map.read().unwrap()
    }
}

/// Numbers from 0 to 1 that look random.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        // Steele et al. 2014, Fast Splittable Pseudorandom Number Generators.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let a = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let b = (a ^ (a >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((b ^ (b >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    fn vector(&mut self, size: f64) -> DVec3 {
        DVec3::new(self.between(-size, size), self.between(-size, size), self.between(-size, size))
    }

    fn one_of<T: Copy>(&mut self, values: &[T]) -> T {
        values[(self.next() * values.len() as f64) as usize]
    }
}

/// A wall with a ball before it.
fn scene() -> Scene {
    Scene(vec![
        Shape::Plane { normal: DVec3::new(0.3, -0.1, -0.9).normalize(), distance: -1.4 },
        Shape::Sphere { centre: DVec3::new(0.1, 0.05, 1.0), radius: 0.25 },
    ])
}

/// The scene as measured, with holes and millimetres of noise.
fn noisy(depth: &Image<f32>, noise: &mut Noise) -> Image<f32> {
    let mut depth = depth.clone();
    for z in depth.data_mut() {
        *z = if noise.next() < 0.05 { 0.0 } else { *z + noise.between(-0.002, 0.002) as f32 };
    }
    depth
}

/// Slots near the scene as a camera sees it: several surfels to a pixel, some before, behind or turned, some empty; some as well known as
/// others.
fn random_slots(noise: &mut Noise, camera: &Intrinsics, pose: &Se3, count: usize, frame: u32) -> Vec<Words> {
    let depth = scene().depth(camera, pose);
    let mut slot = || {
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let pixel = DVec2::new(noise.between(-1.5, w + 0.5), noise.between(-1.5, h + 0.5));
        let nearest = pixel.round().clamp(DVec2::ZERO, DVec2::new(w - 1.0, h - 1.0));
        let z = f64::from(depth[(nearest.x as u32, nearest.y as u32)]);
        let off = noise.one_of(&[0.0, 0.0, 0.0, 0.0, 0.01, -0.01, -0.033, -0.1, 0.1]) + noise.between(-0.004, 0.004);
        let place = pose.transform_point(camera.unproject(pixel, (if z > 0.0 { z } else { 1.5 }) + off));
        let turned = noise.one_of(&[0.1, 0.1, 0.1, 0.8]);
        let normal = (scene().normal(place, pose.translation) + noise.vector(turned)).normalize();
        let colour = std::array::from_fn(|_| (255.0 * noise.next()) as u8);
        let surfel = Surfel {
            position: place.as_vec3(),
            normal: normal.as_vec3(),
            radius_m: (0.9 * z.max(0.5) / camera.fx * noise.between(0.3, 1.6)) as f32,
            submap: 0,
            confidence: noise.one_of(&[0.25, 0.25, 3.5, 12.0, 12.0, noise.0 as f32 * 4e-18 + 0.1]),
            seen: frame.saturating_sub(noise.between(0.0, 26.0) as u32),
            colour: (noise.next() < 0.8).then_some(colour),
        };
        let mut words = surfel.to_words();
        if surfel.colour.is_some() {
            words[7] = ColourVoxel::new(colour, noise.one_of(&[1, 2, 40, 63, 64])).0;
        }
        if noise.next() < 0.15 { [0; SURFEL_WORDS] } else { words }
    };
    (0..count).map(|_| slot()).collect()
}

fn parsed(words: &[Words]) -> Vec<Option<Surfel>> {
    words.iter().map(|words| Surfel::from_words(*words)).collect()
}

/// Empties slots until no rounding decides what becomes of the others.
fn settle(words: &mut [Words], measured: &Measured<'_>) -> Association {
    loop {
        let slots = parsed(words);
        let mut unclear: Vec<usize> = (0..slots.len())
            .filter(|i| slots[*i].is_some_and(|s| reference::associate::role(&s, measured, MARGIN_M).is_none()))
            .collect();
        let found = reference::associate::associate(&slots, measured);
        for (pixel, chosen) in found.chosen.iter().enumerate() {
            let Some(chosen) = chosen else { continue };
            let sample = to_absorb::sample(measured, pixel).unwrap();
            let rival = found.rivals[pixel].and_then(|i| slots[i]);
            if to_absorb::absorbed(&slots[*chosen].unwrap(), rival.as_ref(), &sample, measured, MARGIN_M).is_none() {
                unclear.push(*chosen);
            }
        }
        if unclear.is_empty() {
            return found;
        }
        unclear.into_iter().for_each(|i| words[i] = [0; SURFEL_WORDS]);
    }
}

fn assert_surfel(found: Words, expected: &Surfel, colour: ColourVoxel, what: &str) -> Result<(), TestCaseError> {
    let surfel = Surfel::from_words(found);
    prop_assert!(surfel.is_some(), "{what}: gone");
    let surfel = surfel.unwrap();
    let off = surfel.position.as_dvec3().distance(expected.position.as_dvec3());
    prop_assert!(off < PLACE_M, "{what}: {off} m off");
    let turned = surfel.normal.distance(expected.normal);
    prop_assert!(turned < NORMAL, "{what}: {} but {}", surfel.normal, expected.normal);
    let near = |a: f32, b: f32| (a - b).abs() <= 1e-5 * b;
    prop_assert!((surfel.radius_m / expected.radius_m - 1.0).abs() < RADIUS, "{what}: {surfel:?} but {expected:?}");
    prop_assert!(near(surfel.confidence, expected.confidence), "{what}: {surfel:?} but {expected:?}");
    prop_assert_eq!(surfel.seen, expected.seen);
    let found = ColourVoxel(found[7]);
    prop_assert_eq!(found.weight(), colour.weight(), "{}", what);
    let steps = found.rgb().into_iter().zip(colour.rgb()).map(|(a, b)| a.abs_diff(b)).max();
    prop_assert!(steps <= Some(1), "{what}: {:?} but {:?}", found.rgb(), colour.rgb());
    Ok(())
}

fn size() -> impl Strategy<Value = (u32, u32)> {
    prop_oneof![Just((40, 30)), Just((33, 17)), Just((1, 1)), Just((1, 9)), (2..45u32, 2..35u32)]
}

fn pose() -> impl Strategy<Value = Se3> {
    let (t, r) = (-0.2..0.2, -0.3..0.3);
    [t.clone(), t.clone(), t, r.clone(), r.clone(), r].prop_map(Se3::exp)
}

fn camera(size: (u32, u32), negative_fy: bool) -> Intrinsics {
    let camera = common::camera(size.0, size.1);
    if negative_fy { Intrinsics { fy: -camera.fy, ..camera } } else { camera }
}

proptest! {
    #![proptest_config(common::cases(16))]

    #[test]
    fn measurements_find_move_and_become_surfels_as_in_the_reference(
        size in size(), pose in pose(), seed: u64, negative_fy: bool, shifted_colour: bool, coloured: bool,
        frees: bool, reach in 1u32..4, wide: bool,
    ) {
        let Some(stages) = gpu() else { return Ok(()) };
        let camera = camera(size, negative_fy);
        let calibration = if shifted_colour {
            Calibration {
                colour: common::camera(37, 31),
                colour_from_depth: Se3::exp([0.03, -0.01, 0.005, 0.01, 0.02, -0.03]),
                ..Calibration::registered(camera, DepthConversion::MILLIMETRES)
            }
        } else {
            common::one_camera(camera)
        };
        let mut noise = Noise(seed);
        let pixels = camera.pixels();
        let mut fusion = Fusion::new(stages, calibration, 32);
        fusion.view_options.vertices = Some(reach);
        // The next one is one that forgets.
        fusion.frame = 31;
        fusion.settings.forget_after = 22;
        if wide {
            fusion.settings.reach = 1.6;
            fusion.settings.merge_m = 0.03;
            fusion.settings.max_confidence = 20.0;
            fusion.settings.max_slant_rad = 0.4;
        }
        let image = coloured.then(|| common::colours(&calibration.colour));
        fusion.see(noisy(&scene().depth(&camera, &pose), &mut noise), image.clone());
        let (vertices, normals) = fusion.view.read_vertices(&fusion.gpu.device).unwrap().unwrap();
        let (vertices, normals) = (to_reference(&vertices), to_reference(&normals));
        let settings = fusion.settings.clone();
        let measured = Measured {
            camera: &camera,
            world_from_camera: &pose,
            depth_range_m: RANGE_M,
            vertices: &vertices,
            normals: &normals,
            settings: &settings,
            frame: fusion.frame,
        };
        let mut before = random_slots(&mut noise, &camera, &pose, pixels * 3 / 2 + 5, fusion.frame);
        let found = settle(&mut before, &measured);
        let slots = parsed(&before);
        fusion.map.grow((before.len() + pixels) as u32).unwrap();
        fusion.map.write_words(&before).unwrap();
        let free: Vec<usize> = (0..slots.len()).filter(|i| frees && slots[*i].is_none()).collect();
        if frees {
            fusion.find_free();
        }
        let record = fusion.fuse(&pose);
        let after = fusion.words();

        // What becomes of the surfels that there were.
        let mut expected: Vec<Option<Words>> = before.iter().copied().map(Some).collect();
        let observed = |pixel: usize, margin_px| {
            let image = image.as_ref()?;
            reference::associate::colour_of(vertices.data()[pixel]?, image, &calibration, margin_px)
        };
        let (mut updated, mut merged) = (0, 0);
        for (pixel, chosen) in found.chosen.iter().enumerate() {
            let Some(chosen) = *chosen else { continue };
            let sample = to_absorb::sample(&measured, pixel).unwrap();
            let rival = found.rivals[pixel].and_then(|i| slots[i]);
            let absorbed =
                to_absorb::absorbed(&slots[chosen].unwrap(), rival.as_ref(), &sample, &measured, 0.0).unwrap();
            let fused = |margin_px| {
                let own = ColourVoxel(before[chosen][7]);
                observed(pixel, margin_px).map_or(own, |[r, g, b]| {
                    let colour = DVec3::new(r.into(), g.into(), b.into());
                    reference::integrate::fuse_colour(own, colour, to_absorb::MOST_COLOURS)
                })
            };
            let what = format!("surfel {chosen} at pixel {pixel}");
            let may = assert_surfel(after[chosen], &absorbed.surfel, fused(1e-3), &what);
            assert_surfel(after[chosen], &absorbed.surfel, fused(-1e-3), &what).or(may)?;
            expected[chosen] = None;
            updated += 1;
            if absorbed.merged {
                expected[found.rivals[pixel].unwrap()].as_mut().unwrap()[..4].fill(0);
                merged += 1;
            }
        }
        for i in &found.removed {
            expected[*i].as_mut().unwrap()[..4].fill(0);
        }
        let stable = slots.iter().flatten().filter(|s| s.confidence >= settings.stable).count();
        prop_assert_eq!(
            [record.updated, record.merged, record.removed, record.stable],
            [updated, merged, found.removed.len() as u32, stable as u32]
        );

        // What became a surfel, in the order of the pixels.
        let mut rank = 0;
        for pixel in 0..pixels {
            let becomes = |margin_m| to_absorb::becomes_surfel(&slots, &found, &measured, pixel, margin_m);
            let Some(sample) = to_absorb::sample(&measured, pixel) else { continue };
            let slot = to_absorb::slot_of(rank, &free, before.len(), usize::MAX).unwrap();
            let made = after.get(slot).copied().and_then(Surfel::from_words);
            let is_here = made.is_some_and(|s| s.position.as_dvec3().distance(sample.point) < PLACE_M);
            if !becomes(MARGIN_M) || !(becomes(-MARGIN_M) || is_here) {
                continue;
            }
            prop_assert!(slot < after.len(), "pixel {pixel} became no surfel");
            let made = |margin_px| {
                let colour = observed(pixel, margin_px);
                let packed = colour.map_or(ColourVoxel(0), |rgb| ColourVoxel::new(rgb, 1));
                let surfel = to_absorb::surfel_of(&sample, colour, 0, measured.frame);
                assert_surfel(after[slot], &surfel, packed, &format!("pixel {pixel}'s new surfel in {slot}"))
            };
            made(1e-3).or_else(|_| made(-1e-3))?;
            if slot < expected.len() {
                expected[slot] = None;
            }
            rank += 1;
        }
        prop_assert_eq!((record.new as usize, record.dropped), (rank, 0));
        prop_assert_eq!(record.free as usize, free.len() - rank.min(free.len()));
        prop_assert_eq!(after.len(), before.len() + rank.saturating_sub(free.len()));
        prop_assert_eq!(record.used as usize, after.len());
        for (i, expected) in expected.iter().enumerate() {
            if let Some(expected) = expected {
                prop_assert_eq!(&after[i], expected, "slot {}", i);
            }
        }
        // The cases are worth their name.
        if pixels > 500 && reach == 1 {
            prop_assert!(updated > 20 && (wide || rank > 5) && !found.removed.is_empty(), "{:?}", record);
            let in_front = |i: &usize| {
                let role = reference::associate::role(&slots[*i].unwrap(), &measured, 0.0);
                matches!(role, Some(Role::InFront(_)))
            };
            prop_assert!(found.removed.iter().any(in_front) && !found.removed.iter().all(in_front));
        }
    }

    #[test]
    fn what_moves_and_what_has_left_is_marked_as_in_the_reference_and_is_unstable_then(
        size in size(), pose in pose(), before in pose(), seed: u64, negative_fy: bool,
        cell_px in 1u32..5, levels in 1u32..4, erosion in 0u32..3, iterations in 0u32..5,
    ) {
        let Some(stages) = gpu() else { return Ok(()) };
        let camera = camera(size, negative_fy);
        let mut noise = Noise(seed);
        let mut fusion = Fusion::new(stages, common::one_camera(camera), 32);
        fusion.frame = 29;
        fusion.settings.dynamics.cell_px = cell_px;
        fusion.settings.dynamics.levels = levels;
        fusion.settings.dynamics.erosion = erosion;
        fusion.settings.dynamics.iterations = iterations;
        // Something has come to the right half, and something has left the left half.
        let mut depth = scene().depth(&camera, &pose);
        let within = |x: u32, y: u32, from: f64, to: f64| {
            let (x, y) = (f64::from(x) / f64::from(camera.width), f64::from(y) / f64::from(camera.height));
            (from..to).contains(&x) && (0.2..0.8).contains(&y)
        };
        let mut words = random_slots(&mut noise, &camera, &pose, camera.pixels() * 3 / 2 + 5, fusion.frame);
        for at in 0..camera.pixels() {
            let (x, y) = (at as u32 % camera.width, at as u32 / camera.width);
            let z = f64::from(depth.data()[at]);
            if z > 0.6 && within(x, y, 0.1, 0.45) {
                let place = pose.transform_point(camera.unproject(DVec2::new(x.into(), y.into()), z - 0.35));
                let surfel = Surfel {
                    position: place.as_vec3(),
                    normal: scene().normal(place, pose.translation).as_vec3(),
                    radius_m: (0.9 * z / camera.fx) as f32,
                    submap: 0,
                    confidence: noise.one_of(&[8.0, 12.0, 15.0]),
                    seen: 28,
                    colour: None,
                };
                words.push(surfel.to_words());
            } else if z > 0.6 && within(x, y, 0.55, 0.9) {
                depth.data_mut()[at] -= 0.3;
            }
        }
        fusion.see(noisy(&depth, &mut noise), None);
        let (vertices, normals) = fusion.view.read_vertices(&fusion.gpu.device).unwrap().unwrap();
        let (vertices, normals) = (to_reference(&vertices), to_reference(&normals));
        let settings = fusion.settings.clone();
        let measured = Measured {
            camera: &camera,
            world_from_camera: &pose,
            depth_range_m: RANGE_M,
            vertices: &vertices,
            normals: &normals,
            settings: &settings,
            frame: fusion.frame,
        };
        let found = settle(&mut words, &measured);
        let slots = parsed(&words);
        fusion.map.grow(words.len() as u32).unwrap();
        fusion.map.write_words(&words).unwrap();

        // What was seen before, from another pose.
        let world_from_model = pose * Se3::exp(before.log().map(|v| 0.1 * v));
        let device = &fusion.gpu.device;
        let model = RaycastImage::new(device, camera).unwrap();
        let cells = Segmentation::new(device, camera, &settings.dynamics);
        let mut recorder = Recorder::new(device);
        let drawn = Drawn { least: 0.0, preferred: 8.0, since: 0, reach: 1.5, fill: 1.0 };
        stages.1.splat.record(&mut recorder, &fusion.map, &fusion.pixels, &model, &fusion.options(&world_from_model), drawn);
        let options = fusion.options(&pose);
        let calibration = &fusion.calibration;
        stages.1.associate.record(&mut recorder, &fusion.map, &fusion.view, &fusion.pixels, calibration, &options);
        let seen = (&model, &world_from_model);
        stages.1.segment.record(&mut recorder, &fusion.map, &fusion.view, &cells, seen, &options);
        let reader = fusion.map.record_counters(&mut recorder);
        let _untimed = recorder.submit();
        let record = reader.read(device).unwrap();
        let marks = cells.read(device).unwrap();
        let after = fusion.words();

        let points = model.read_points(device).unwrap();
        let point = |&[x, y, z, w]: &[f32; 4]| {
            (w > 0.0).then(|| (DVec3::new(x.into(), y.into(), z.into()), f64::from(w) - 1.0))
        };
        let points = Image::new(camera.width, camera.height, points.data().iter().map(point).collect()).unwrap();
        let known = Known { points: &points, world_from_model: &world_from_model };
        let vacant = reference::segment::vacant(&slots, &measured);
        let least = reference::segment::segment(&measured, &known, &vacant, -MARGIN_M);
        let most = reference::segment::segment(&measured, &known, &vacant, MARGIN_M);
        prop_assert_eq!(marks.size(), least.size());
        let mut unsure = 0;
        for (cell, found) in marks.data().iter().enumerate() {
            let (least, most) = (least.data()[cell].marks, most.data()[cell].marks);
            prop_assert!(found.dynamic >= least.dynamic && found.dynamic <= most.dynamic, "cell {cell}: {found:?}");
            prop_assert!(found.vacant >= least.vacant && found.vacant <= most.vacant, "cell {cell}: {found:?}");
            unsure += usize::from(least != most);
        }
        prop_assert!(unsure <= 2 + marks.data().len() / 20, "{unsure} of {} cells are not tested", marks.data().len());
        let mut fallen = 0;
        for (i, slot) in slots.iter().enumerate() {
            let Some(surfel) = slot.filter(|_| !found.removed.contains(&i)) else { continue };
            let role = reference::associate::role(&surfel, &measured, 0.0).unwrap();
            let falls = |cells, margin_m| reference::segment::falls(&surfel, role, cells, &measured, margin_m);
            let may = falls(&most, MARGIN_M);
            let has = after[i] != words[i];
            prop_assert!(has >= falls(&least, -MARGIN_M) && has <= may, "surfel {i}, {role:?}: {has}");
            if has {
                let mut expected = words[i];
                expected[3] = settings.dynamics.fallen.to_bits();
                prop_assert_eq!(after[i], expected);
                fallen += 1;
            }
        }
        prop_assert_eq!(record.demoted, fallen);
        // The cases are worth their name.
        if camera.pixels() > 1000 && erosion == 0 && cell_px < 4 {
            let count = |is: fn(&itm_gpu::segment::CellMarks) -> bool| marks.data().iter().filter(|m| is(m)).count();
            let (dynamic, vacant) = (count(|m| m.dynamic), count(|m| m.vacant));
            prop_assert!(dynamic > 5 && vacant > 5 && fallen > 5, "{dynamic} cells move, {vacant} are left: {record:?}");
        }
    }

    #[test]
    fn each_pixel_shows_the_disc_that_the_reference_shows(
        size in size(), drawn_from in pose(), motion in pose(), seed: u64, negative_fy: bool, near: bool, wide: bool,
        since in 0u32..29, fill in 1.0f32..3.0,
    ) {
        let Some(stages) = gpu() else { return Ok(()) };
        let camera = camera(size, negative_fy);
        let mut noise = Noise(seed);
        let mut fusion = Fusion::new(stages, common::one_camera(camera), 32);
        fusion.frame = 29;
        let mut words = random_slots(&mut noise, &camera, &drawn_from, camera.pixels() * 3 / 2 + 5, 29);
        for words in &mut words {
            // Nearly all different, which tells them apart.
            let scale = if words[3] == 0 { 0.0 } else { noise.between(0.1, 20.0) };
            words[3] = (scale as f32).to_bits();
            if wide {
                words[5] = (f32::from_bits(words[5]) * 4.0).to_bits();
            }
        }
        fusion.map.write_words(&words).unwrap();
        let pose = if near { drawn_from * Se3::exp([0.0, 0.0, 0.45, 0.0, 0.0, 0.0]) } else { drawn_from * motion };
        let settings = fusion.settings.clone();
        let look = Look {
            camera: &camera,
            world_from_camera: &pose,
            depth_range_m: RANGE_M,
            settings: &settings,
            drawn: Drawn { least: 2.0, preferred: 8.0, since, reach: if wide { 1.4 } else { 1.0 }, fill },
        };
        let (points, normals, colours) = fusion.splat(camera, &pose, look.drawn);
        let slots = parsed(&words);
        let expected = reference::splat::splat(&slots, &look);
        // Where a disc is seen from the side, its depth magnifies roundings ten times.
        let (margin_m, rounding_m) = (5e-5, 5e-5);
        // The discs that are drawn whatever roundings do, and those that may be.
        let moved = [DVec2::ZERO, DVec2::X, DVec2::Y, DVec2::NEG_X, DVec2::NEG_Y].map(|side| side * MARGIN_PX);
        let kept = moved.map(|moved| [0.0, margin_m, -margin_m].map(|m| reference::splat::kept(&slots, &look, moved, m)));
        let kept: Vec<_> = kept.into_iter().flatten().collect();
        let surely = kept.iter().skip(1).fold(kept[0].clone(), |some, other| some.into_iter().filter(|k| other.contains(k)).collect());
        let perhaps: Vec<_> = kept.into_iter().flatten().collect();
        let mut others = 0;
        for (at, expected) in expected.data().iter().enumerate() {
            let (x, y) = (at as u32 % camera.width, at as u32 / camera.width);
            let (pixel, pixel_at) = (DVec2::new(x.into(), y.into()), UVec2::new(x, y));
            let (point, normal) = (points.data()[at], normals.data()[at]);
            let turned = |s: &Surfel| glam::Vec4::from(normal).distance(s.normal.extend(1.0));
            let is_this =
                |surfel: &Option<Surfel>| surfel.is_some_and(|s| s.confidence + 1.0 == point[3] && turned(&s) < 1e-5);
            let found = slots.iter().position(is_this);
            prop_assert_eq!(found.is_some(), point[3] > 0.0);
            let meet = |i: usize, times, margin_m| reference::splat::meet(slots[i].as_ref()?, &look, pixel, times, margin_m);
            let fill = f64::from(fill);
            if found != expected.map(|(i, _)| i) {
                // Another answer is right only where rounding decides.
                others += 1;
                let is_preferred = |i: usize| slots[i].is_some_and(|s| s.confidence >= look.drawn.preferred);
                let class = found.map(is_preferred);
                let fills = found.is_some_and(|i| meet(i, 1.0, margin_m).is_none());
                let met = |some: &[_], margin_m| reference::splat::met(&slots, &look, some, pixel_at, margin_m);
                let must = met(&surely, -margin_m);
                // What may be met: where no disc is surely met, those that would fill as well.
                let mut may: Vec<_> = [margin_m, -margin_m].iter().flat_map(|m| met(&perhaps, *m)).collect();
                let surely_met = surely.iter().any(|(i, _)| meet(*i, 1.0, -margin_m).is_some());
                if !surely_met {
                    let near = |cell: IVec2| (cell - pixel_at.as_ivec2()).abs().max_element() <= 1;
                    let around = perhaps.iter().filter(|(_, cell)| near(*cell));
                    may.extend(around.filter_map(|(i, _)| Some((*i, meet(*i, fill, margin_m)?))));
                }
                let nearest = |some: &[(usize, f64)]| {
                    let alike = some.iter().filter(|(i, _)| class.is_none_or(|class| is_preferred(*i) == class));
                    alike.map(|(_, z)| *z).fold(f64::INFINITY, f64::min)
                };
                let window_m = |z| reference::associate::window(&settings, z);
                match found {
                    None => prop_assert!(must.is_empty(), "pixel {} shows nothing", pixel),
                    Some(found) => {
                        prop_assert!(may.iter().any(|(i, _)| *i == found), "{pixel} shows {found}, not {expected:?}");
                        if fills {
                            let meets = surely.iter().find(|(i, _)| meet(*i, 1.0, -margin_m).is_some());
                            prop_assert!(meets.is_none(), "{pixel} shows {found}, but meets {meets:?}");
                        }
                        // Only what is met as this one is is better.
                        let times = if fills { fill } else { 1.0 };
                        // Where this one is met, others that would fill are not looked at, though none is surely met.
                        let must: Vec<_> = must.into_iter().filter(|(i, _)| meet(*i, times, -margin_m).is_some()).collect();
                        let better = must.iter().any(|(i, _)| class == Some(false) && is_preferred(*i));
                        prop_assert!(!better, "{} shows {:?}, not {:?}", pixel, found, expected);
                        let z = meet(found, times, margin_m).unwrap();
                        prop_assert!(z <= nearest(&must) + window_m(nearest(&must)) + rounding_m, "{pixel}: {found} is hidden");
                        let limit = nearest(&may) + window_m(nearest(&may)) - rounding_m;
                        let rank = |i: usize| slots[i].map_or(0, |s| confidence_rank(s.confidence));
                        let better = must.iter().find(|(i, z)| rank(*i) > rank(found) && *z < limit && is_preferred(*i) == is_preferred(found));
                        prop_assert!(better.is_none(), "{pixel} shows {found}, not {better:?}");
                    }
                }
            }
            let Some(found) = found else {
                prop_assert_eq!((point, normal, colours.data()[at]), ([0.0; 4], [0.0; 4], [0; 4]));
                continue;
            };
            let z = meet(found, 1.0, margin_m).or_else(|| meet(found, fill, margin_m)).unwrap();
            let [x, y, z_world, _] = point.map(f64::from);
            let off = DVec3::new(x, y, z_world).distance(reference::splat::point_at(&look, pixel, z));
            prop_assert!(off < rounding_m, "{pixel}: {off} m off");
            let surfel = slots[found].unwrap();
            let colour = surfel.colour.map_or([0; 4], |[r, g, b]| [r, g, b, 255]);
            prop_assert_eq!(colours.data()[at], colour);
        }
        prop_assert!(others <= 1 + camera.pixels() / 100, "{others} pixels show something else");
    }
}

#[test]
fn lists_for_tracking_have_the_colours_of_the_surfels_that_are_seen() {
    let Some(stages) = gpu() else { return };
    let camera = common::camera(41, 30);
    let pose = Se3::exp([0.05, -0.02, 0.1, 0.02, 0.1, -0.03]);
    let mut fusion = Fusion::new(stages, common::one_camera(camera), 32);
    fusion.map.write_words(&random_slots(&mut Noise(4), &camera, &pose, 2000, 40)).unwrap();
    let device = &fusion.gpu.device;
    let (image, pixels) = (RaycastImage::new(device, camera).unwrap(), SurfelView::new(device, camera));
    let evaluator = Evaluator::new(device);
    let list = PointList::new(device, &image, 1, 2);
    let mut recorder = Recorder::new(device);
    fusion.stages.splat.record(&mut recorder, &fusion.map, &pixels, &image, &fusion.options(&pose), ALL);
    evaluator.photometric.list_surfels(&mut recorder, &list, &image, &pixels, &pose);
    let _untimed = recorder.submit();
    let (points, colours) = (image.read_points(device).unwrap(), pixels.read_colours(device).unwrap());
    let listed = list.read(device, 1).unwrap();
    let width = camera.width.div_ceil(2);
    assert_eq!(listed.len(), (width * camera.height.div_ceil(2)) as usize);
    let mut known = 0;
    for (i, listed) in listed.iter().enumerate() {
        let (x, y) = (2 * (i as u32 % width) + 1, 2 * (i as u32 / width) + 1);
        let at = (x.min(camera.width - 1), y.min(camera.height - 1));
        let ([px, py, pz, _], colour) = (points[at], colours[at]);
        assert_eq!(*listed, (colour[3] > 0).then_some(([px, py, pz], colour)), "{at:?}");
        known += usize::from(listed.is_some());
    }
    assert!(known > 100, "{known} points");
}

/// A map of the scene as a camera that moves a little sees it, with slots that became free found now and then.
fn filled<'a>(stages: (&'a Gpu, &'a Stages), frames: u32) -> Fusion<'a> {
    let camera = common::camera(40, 30);
    let mut fusion = Fusion::new(stages, common::one_camera(camera), 4096);
    let mut noise = Noise(5);
    for i in 0..frames {
        let pose = Se3::exp([0.003 * f64::from(i), 0.0, 0.0, 0.0, 0.002 * f64::from(i), 0.0]);
        let depth = noisy(&scene().depth(&camera, &pose), &mut noise);
        fusion.see(depth, Some(common::colours(&camera)));
        if i % 5 == 4 {
            fusion.find_free();
        }
        fusion.fuse(&pose);
    }
    fusion
}

#[test]
fn a_second_run_leaves_the_same_bytes() {
    let Some(stages) = gpu() else { return };
    let (one, two) = (filled(stages, 30), filled(stages, 30));
    assert!(one.words() == two.words());
    assert_eq!(one.map.read_record().unwrap(), two.map.read_record().unwrap());
    let pose = Se3::exp([0.01, 0.0, 0.02, 0.0, 0.1, 0.0]);
    let camera = common::camera(81, 61);
    const SOME: Drawn = Drawn { least: 0.5, preferred: 5.0, since: 0, reach: 1.0, fill: 3.0 };
    assert!(one.splat(camera, &pose, SOME) == two.splat(camera, &pose, SOME));
}

#[test]
fn free_slots_are_taken_first_and_in_order_and_without_room_the_rest_is_intact() {
    let Some(stages) = gpu() else { return };
    let camera = common::camera(20, 15);
    let mut fusion = Fusion::new(stages, common::one_camera(camera), 128);
    // Surfels far out of view, but for every third slot.
    let kept = |i: u32| Surfel {
        position: glam::Vec3::new(i as f32, 0.0, -5.0),
        normal: glam::Vec3::Y,
        radius_m: 0.01,
        submap: 0,
        confidence: 50.0,
        seen: 1,
        colour: None,
    };
    let before: Vec<Words> =
        (0..100).map(|i| if i % 3 == 0 { [0; SURFEL_WORDS] } else { kept(i).to_words() }).collect();
    fusion.map.write_words(&before).unwrap();
    fusion.find_free();
    let free: Vec<usize> = (0..100).step_by(3).collect();
    assert_eq!(fusion.map.read_record().unwrap().free as usize, free.len());
    assert_eq!(fusion.words(), before);

    // One strip of the image at a time.
    let depth = scene().depth(&camera, &Se3::IDENTITY);
    let strip =
        |rows: std::ops::Range<u32>| Image::from_fn(20, 15, |x, y| if rows.contains(&y) { depth[(x, y)] } else { 0.0 });
    let mut made: Vec<DVec3> = Vec::new();
    let (mut used, mut left) = (100, free.len());
    for (rows, find_again) in [(0..3, false), (4..7, true), (8..15, false)] {
        fusion.see(strip(rows), None);
        let (vertices, _) = fusion.view.read_vertices(&fusion.gpu.device).unwrap().unwrap();
        let record = fusion.fuse(&Se3::IDENTITY);
        let in_free = (record.new as usize).min(left);
        left -= in_free;
        let behind = record.new as usize - in_free;
        let placed = behind.min(128 - used);
        used += placed;
        assert_eq!((record.free as usize, record.used as usize), (left, used), "{record:?}");
        assert_eq!(record.dropped as usize, behind - placed);
        assert_eq!((record.removed, record.updated, record.merged), (0, 0, 0));
        let after = fusion.words();
        // In the order of pixels: each new surfel lies behind those before it in its strip.
        let slots: Vec<usize> = (made.len()..)
            .take(in_free + placed)
            .map(|rank| to_absorb::slot_of(rank, &free, 100, 128).unwrap())
            .collect();
        let places: Vec<DVec3> =
            slots.iter().map(|i| Surfel::from_words(after[*i]).expect("a new surfel").position.as_dvec3()).collect();
        let vertices = to_reference(&vertices);
        let pixel = |p: &DVec3| vertices.data().iter().position(|v| v.is_some_and(|v| v.distance(*p) < PLACE_M));
        let of_pixels: Vec<usize> = places.iter().map(|p| pixel(p).expect("a measurement")).collect();
        assert!(of_pixels.is_sorted_by(|a, b| a < b), "{of_pixels:?}");
        made.extend(places);
        for (i, (before, after)) in before.iter().zip(&after).enumerate() {
            assert!(i % 3 == 0 || before == after, "slot {i}");
        }
        if find_again {
            // Those that were taken are not found again.
            fusion.find_free();
            assert_eq!(fusion.map.read_record().unwrap().free as usize, left);
        }
    }
    let record = fusion.map.read_record().unwrap();
    assert!(record.dropped > 20 && record.used == 128 && left == 0, "{record:?}");
    // All that found room are still there.
    let surfels = fusion.surfels();
    assert_eq!(surfels.len(), 128);
    assert!(made.iter().all(|p| surfels.iter().any(|s| s.position.as_dvec3().distance(*p) < PLACE_M)));
    // With room, the rest is made up for.
    fusion.map.grow(1000).unwrap();
    let dropped = record.dropped;
    fusion.fuse(&Se3::IDENTITY);
    let record = fusion.map.read_record().unwrap();
    assert!(record.new <= dropped && record.dropped == 0 && record.used == 128 + record.new, "{record:?}");
}

#[test]
fn a_map_keeps_everything_as_it_grows() {
    let Some(stages) = gpu() else { return };
    let mut fusion = filled(stages, 12);
    let (before, record) = (fusion.words(), fusion.map.read_record().unwrap());
    let capacity = fusion.map.capacity();
    fusion.map.grow(3 * capacity).unwrap();
    assert_eq!(fusion.map.capacity(), 3 * capacity);
    assert!(fusion.words() == before);
    assert_eq!(fusion.map.read_record().unwrap(), record);
    // It goes on as one that had the room from the start.
    let mut other = filled(stages, 12);
    let depth = scene().depth(&common::camera(40, 30), &Se3::IDENTITY);
    for fusion in [&mut fusion, &mut other] {
        fusion.see(depth.clone(), None);
        fusion.fuse(&Se3::IDENTITY);
    }
    assert!(fusion.words() == other.words());
    fusion.map.grow(1).unwrap();
    assert_eq!(fusion.map.capacity(), 3 * capacity, "it does not shrink");
}

#[test]
fn submaps_are_seen_one_by_one_and_together_as_they_lie() {
    let Some(stages) = gpu() else { return };
    let camera = common::camera(40, 30);
    let pose = Se3::exp([0.05, -0.02, 0.1, 0.02, 0.1, -0.03]);
    let moved = Se3::exp([0.4, -0.3, 0.2, 0.5, -0.2, 0.3]);
    let mut noise = Noise(3);
    let words = random_slots(&mut noise, &camera, &pose, 2000, 40);
    let mut fusion = Fusion::new(stages, common::one_camera(camera), 32);
    fusion.map.write_words(&words).unwrap();
    let whole = fusion.splat(camera, &pose, ALL);

    // Every other one in another frame.
    let in_submaps: Vec<Words> = (0..)
        .zip(&words)
        .map(|(i, words)| match Surfel::from_words(*words) {
            Some(surfel) if i % 2 == 1 => {
                let submap_from_world = moved.inverse();
                let position = submap_from_world.transform_point(surfel.position.as_dvec3()).as_vec3();
                let normal = submap_from_world.transform_vector(surfel.normal.as_dvec3()).as_vec3();
                let moved = Surfel { position, normal, submap: 1, ..surfel }.to_words();
                [moved[0], moved[1], moved[2], moved[3], moved[4], moved[5], moved[6], words[7]]
            }
            _ => *words,
        })
        .collect();
    fusion.map.write_words(&in_submaps).unwrap();
    let look = |part| {
        let device = &fusion.gpu.device;
        let (image, pixels) = (RaycastImage::new(device, camera).unwrap(), SurfelView::new(device, camera));
        let mut recorder = Recorder::new(device);
        let pose = if part == Part::Submap(1) { moved.inverse() * pose } else { pose };
        let options = SurfelOptions { part, ..fusion.options(&pose) };
        fusion.stages.splat.record(&mut recorder, &fusion.map, &pixels, &image, &options, ALL);
        let _untimed = recorder.submit();
        (image.read_points(device).unwrap(), image.read_normals(device).unwrap(), pixels.read_colours(device).unwrap())
    };
    let poses = [Se3::IDENTITY, moved];
    let together = look(Part::Combined(&poses));
    let differ = (0..camera.pixels()).filter(|i| {
        let (a, b) = (whole.0.data()[*i], together.0.data()[*i]);
        let off = (0..4).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
        off > 1e-4 || whole.2.data()[*i] != together.2.data()[*i]
    });
    // Where roundings decide what is seen.
    let differ = differ.count();
    assert!(differ < camera.pixels() / 50, "{differ} pixels differ");
    for submap in [0, 1] {
        let alone = look(Part::Submap(submap));
        let own = |words: &Words| Surfel::from_words(*words).is_some_and(|surfel| surfel.submap == submap);
        let kept: Vec<Words> = in_submaps.iter().map(|words| if own(words) { *words } else { [0; 8] }).collect();
        let mut only = Fusion::new(stages, common::one_camera(camera), 32);
        only.map.write_words(&kept).unwrap();
        let pose = if submap == 1 { moved.inverse() * pose } else { pose };
        assert!(only.splat(camera, &pose, ALL) == alone, "submap {submap}");
        assert!(alone.0.data().iter().filter(|point| point[3] > 0.0).count() > camera.pixels() / 2);
    }

    // What is fused into one leaves the other alone, but for what is hardly known of it, and new surfels belong to it.
    fusion.frame = 100;
    fusion.see(scene().depth(&camera, &pose), None);
    let mut recorder = Recorder::new(&fusion.gpu.device);
    let in_submap = moved.inverse() * pose;
    fusion.map.grow(4000).unwrap();
    let options = SurfelOptions { part: Part::Submap(1), ..fusion.options(&in_submap) };
    let Fusion { stages, map, view, pixels, calibration, .. } = &fusion;
    stages.associate.record(&mut recorder, map, view, pixels, calibration, &options);
    stages.absorb.record(&mut recorder, map, view, pixels, &options);
    let _untimed = recorder.submit();
    let after = fusion.words();
    for (i, (before, after)) in in_submaps.iter().zip(&after).enumerate() {
        match Surfel::from_words(*before) {
            Some(surfel) if surfel.submap == 0 && surfel.confidence < fusion.settings.track_from => {
                assert_eq!(Surfel::from_words(*after), None, "slot {i}");
            }
            Some(surfel) if surfel.submap == 0 => assert_eq!(before, after, "slot {i}"),
            Some(_) | None => {}
        }
    }
    let weak = |surfel: &Surfel| surfel.submap == 0 && surfel.confidence < fusion.settings.track_from;
    assert!(parsed(&in_submaps).iter().flatten().any(weak));
    let new: Vec<Surfel> = after[in_submaps.len()..].iter().filter_map(|words| Surfel::from_words(*words)).collect();
    assert!(new.len() > 20 && new.iter().all(|surfel| surfel.submap == 1 && surfel.seen == fusion.frame));
}

#[test]
fn pages_make_no_difference() {
    let Some(stages) = gpu() else { return };
    let device = common::device_with_bindings_of(16 << 20);
    let (paged, paged_stages) = (Gpu::new(&device), Stages::new(&device));
    // So many surfels lie in a page.
    let page = 1 << 20;
    let camera = common::camera(40, 30);
    // The first page holds what is out of view, and some empty slots, but for its last ones.
    let far = Surfel {
        position: glam::Vec3::new(0.0, 0.0, -50.0),
        normal: glam::Vec3::Y,
        radius_m: 0.01,
        submap: 0,
        confidence: 50.0,
        seen: 1,
        colour: None,
    };
    let words = far.to_words();
    let filled: Vec<Words> = (0..page - 600).map(|i| if i % 4099 == 7 { [0; SURFEL_WORDS] } else { words }).collect();
    let run = |stages| {
        let mut fusion = Fusion::new(stages, common::one_camera(camera), 32);
        let mut noise = Noise(11);
        fusion.map.write_words(&filled).unwrap();
        fusion.settings.patience = 2;
        for i in 0..8 {
            match i {
                2 => fusion.map.grow(page + 300).unwrap(),
                3 => fusion.map.grow(page + 8000).unwrap(),
                5 => fusion.find_free(),
                _ => {}
            }
            let pose = Se3::exp([0.0, 0.0, 0.0, 0.0, 0.1 * f64::from(i), 0.0]);
            fusion.see(noisy(&scene().depth(&camera, &pose), &mut noise), Some(common::colours(&camera)));
            fusion.fuse(&pose);
        }
        let record = fusion.map.read_record().unwrap();
        fusion.find_free();
        let look = fusion.splat(camera, &Se3::exp([0.0, 0.0, 0.0, 0.0, 0.6, 0.0]), ALL);
        (record, fusion.map.read_record().unwrap().free, fusion.words(), look)
    };
    let (one, many) = (run(stages), run((&paged, &paged_stages)));
    assert_eq!((one.0, one.1), (many.0, many.1));
    assert!(one.2 == many.2, "other surfels");
    assert!(one.3 == many.3, "another image");
    assert!(one.0.used > page + 300 && one.0.removed > 0 && one.1 > 0, "{:?}, {} free", one.0, one.1);
    assert!(one.3.0.data().iter().filter(|point| point[3] > 0.0).count() > 300);
}

#[test]
fn an_image_is_the_same_where_it_is_drawn_in_bands() {
    let Some(stages) = gpu() else { return };
    let device = common::device_with_bindings_of(16 << 20);
    let (small, small_stages) = (Gpu::new(&device), Stages::new(&device));
    // Of 16 MiB a band has 490 rows at most.
    let (camera, few) = (common::camera(1050, 520), common::camera(90, 45));
    let pose = Se3::exp([0.05, -0.02, 0.1, 0.02, 0.1, -0.03]);
    let words = random_slots(&mut Noise(4), &few, &pose, 6000, 40);
    let run = |stages| {
        let mut fusion = Fusion::new(stages, common::one_camera(few), 32);
        fusion.map.write_words(&words).unwrap();
        fusion.splat(camera, &pose, Drawn { least: 0.5, preferred: 5.0, since: 0, reach: 1.5, fill: 1.0 })
    };
    let (one, many) = (run(stages), run((&small, &small_stages)));
    let (one, many) = (one.0.data(), many.0.data());
    // Roundings differ, for the bands' cameras do.
    let off = |a: &[f32; 4], b: &[f32; 4]| a.iter().zip(b).any(|(a, b)| (a - b).abs() > 1e-4);
    let others = one.iter().zip(many).filter(|(a, b)| off(a, b)).count();
    assert!(others <= one.len() / 1000, "{others} pixels are others");
    for rows in [0..100, 420..520] {
        let seen = |points: &&[f32; 4]| points[3] > 0.0;
        assert!(one[rows.start * 1050..rows.end * 1050].iter().filter(seen).count() > 10_000);
    }
}

#[test]
fn what_was_fused_is_drawn_with_the_list_that_is_there_as_with_another() {
    let Some(stages) = gpu() else { return };
    let camera = common::camera(80, 60);
    let (mut fusion, mut noise) = (Fusion::new(stages, common::one_camera(camera), 40_000), Noise(3));
    for i in 0..12 {
        let pose = Se3::exp([0.01 * f64::from(i), 0.0, 0.0, 0.0, 0.03 * f64::from(i), 0.0]);
        fusion.see(noisy(&scene().depth(&camera, &pose), &mut noise), Some(common::colours(&camera)));
        let record = fusion.fuse(&pose);
        if i % 3 == 2 {
            fusion.find_free();
        }
        for least in [0.0, 2.0] {
            let drawn = Drawn { least, preferred: 3.0, since: 8, reach: 1.0, fill: 3.0 };
            let (listed, fresh) = (fusion.splat_listed(&pose, drawn), fusion.splat(camera, &pose, drawn));
            // Of discs about as well known the first in the list is drawn, and new ones come last here: another one of the same surface.
            let there = |points: &Image<[f32; 4]>| points.data().iter().map(|p| p[3] > 0.0).collect::<Vec<_>>();
            assert!(there(&listed.0) == there(&fresh.0), "frame {i}");
            let pairs = || listed.0.data().iter().zip(fresh.0.data()).filter(|(a, _)| a[3] > 0.0);
            let others = pairs().filter(|(a, b)| a != b).count();
            assert!(others * 50 <= pairs().count(), "frame {i}: {others} of {}", pairs().count());
            for (a, b) in pairs() {
                let [a, b] = [a, b].map(|p| DVec3::new(p[0].into(), p[1].into(), p[2].into()));
                assert!(a.distance(b) < 0.1, "frame {i}: {a} and {b}");
            }
        }
        assert!(record.new > 0, "frame {i}");
    }
}

#[test]
fn what_leaves_the_view_stays_and_what_is_looked_at_and_not_seen_again_goes() {
    let Some(stages) = gpu() else { return };
    let camera = common::camera(64, 48);
    let wall = |distance: f64| Scene(vec![Shape::Plane { normal: DVec3::NEG_Z, distance: -distance }]);
    let away = Se3::exp([0.0, 0.0, 0.0, 0.0, 1.2, 0.0]);
    let mut fusion = Fusion::new(stages, common::one_camera(camera), 20_000);
    fusion.settings.patience = 5;
    fusion.settings.forget_after = 60;
    fusion.see(wall(1.5).depth(&camera, &Se3::IDENTITY), None);
    let first = fusion.fuse(&Se3::IDENTITY).new;
    let of_wall = |fusion: &Fusion<'_>| fusion.surfels().iter().filter(|s| s.seen == 1).count() as u32;
    assert!(first > 2000 && of_wall(&fusion) == first);
    // Nobody looks.
    for _ in 0..20 {
        fusion.see(Scene(Vec::new()).depth(&camera, &away), None);
        fusion.fuse(&away);
    }
    assert_eq!(of_wall(&fusion), first);
    // Something stands before it.
    fusion.see(wall(1.0).depth(&camera, &Se3::IDENTITY), None);
    fusion.fuse(&Se3::IDENTITY);
    assert_eq!(of_wall(&fusion), first);
    // The wall behind it is seen: it was none. So few times nothing there is stable, and its age alone says so.
    fusion.see(wall(2.0).depth(&camera, &Se3::IDENTITY), None);
    fusion.fuse(&Se3::IDENTITY);
    assert!(of_wall(&fusion) < first / 20, "{} of {first} are left", of_wall(&fusion));
    // What nobody looks at is forgotten in the end.
    let near = fusion.surfels().len();
    assert!(near > 2000);
    for _ in 0..80 {
        fusion.see(Scene(Vec::new()).depth(&camera, &away), None);
        fusion.fuse(&away);
    }
    assert!(fusion.surfels().is_empty(), "{} of {near} are left", fusion.surfels().len());
}

#[test]
fn a_plane_stays_a_plane_of_as_many_surfels_as_pixels() {
    let Some(stages) = gpu() else { return };
    let camera = common::camera(64, 48);
    let plane = Scene(vec![Shape::Plane { normal: DVec3::new(0.3, -0.2, -0.93).normalize(), distance: -1.2 }]);
    for moving in [0.0, 1.0] {
        let mut fusion = Fusion::new(stages, common::one_camera(camera), 8192);
        for i in 0..30 {
            let t = moving * (f64::from(i) * 0.4).sin();
            let pose = Se3::exp([0.004 * t, 0.003 * t, -0.005 * t, 0.002 * t, 0.003 * t, 0.004 * t]);
            fusion.see(plane.depth(&camera, &pose), None);
            if i % 8 == 7 {
                fusion.find_free();
            }
            fusion.fuse(&pose);
        }
        let surfels = fusion.surfels();
        let pixels = camera.pixels();
        let share = surfels.len() as f64 / pixels as f64;
        assert!((0.5..=1.3).contains(&share), "{} surfels of {pixels} pixels", surfels.len());
        let off: Vec<f64> = surfels.iter().map(|s| plane.distance(s.position.as_dvec3())).collect();
        assert!(common::quantile(off.clone(), 0.5) < 1e-4 && common::quantile(off, 1.0) < 1e-3);
        let turned = surfels.iter().map(|s| s.normal.as_dvec3().distance(plane.normal(DVec3::ZERO, DVec3::ZERO)));
        assert!(turned.fold(0.0, f64::max) < 2e-2);
        // Seen again, from afar, and by larger pixels, it has no holes.
        for (away, seen_by) in
            [(1.0, camera), (2.0, camera), (2.0, common::camera(16, 12)), (3.0, common::camera(12, 9))]
        {
            let pose = Se3::exp([0.0, 0.0, 1.2 * (1.0 - away), 0.0, 0.0, 0.0]);
            let (points, ..) =
                fusion.splat(seen_by, &pose, Drawn { least: 5.0, preferred: 5.0, since: 0, reach: 1.0, fill: 3.0 });
            let size = DVec2::new(seen_by.width.into(), seen_by.height.into());
            let inner = |i: usize| {
                let pixel = DVec2::new((i as u32 % seen_by.width).into(), (i as u32 / seen_by.width).into());
                (pixel + 0.5 - 0.5 * size).abs().cmplt(0.42 * size / away).all()
            };
            let inner: Vec<usize> = (0..seen_by.pixels()).filter(|i| inner(*i)).collect();
            let holes = inner.iter().filter(|i| points.data()[**i][3] == 0.0).count();
            assert!(
                inner.len() > 5 && holes * 200 <= inner.len(),
                "{holes} of {} pixels show nothing at {away}",
                inner.len()
            );
            for point in to_reference(&points).data().iter().flatten() {
                assert!(plane.distance(*point) < 2e-3, "{point}");
            }
        }
    }
}

#[test]
fn a_colour_that_stays_is_the_surfels_colour() {
    let Some(stages) = gpu() else { return };
    let camera = common::camera(33, 17);
    for with_fy in [camera, Intrinsics { fy: -camera.fy, ..camera }, common::camera(9, 8)] {
        let mut fusion = Fusion::new(stages, common::one_camera(with_fy), 4096);
        let image = ColourImage::filled(with_fy.width, with_fy.height, [10, 200, 255, 255]);
        for i in 0..10 {
            let pose = Se3::exp([0.0, 0.0, 0.0, 0.0, 0.01 * f64::from(i % 2), 0.0]);
            fusion.see(scene().depth(&with_fy, &pose), Some(image.clone()));
            fusion.fuse(&pose);
        }
        let surfels = fusion.surfels();
        assert!(!surfels.is_empty());
        assert!(surfels.iter().all(|s| s.colour == Some([10, 200, 255])), "{surfels:?}");
        let (points, _, colours) = fusion.splat(with_fy, &Se3::IDENTITY, ALL);
        for (point, colour) in points.data().iter().zip(colours.data()) {
            assert_eq!(*colour, if point[3] > 0.0 { [10, 200, 255, 255] } else { [0; 4] });
        }
    }
}
