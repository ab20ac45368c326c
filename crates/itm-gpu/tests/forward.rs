//! Stage `forward` on the device, against its reference, and with the rays that it leaves to `raycast` against a full raycast.

#![allow(clippy::unwrap_used, reason = "this is a test, and its helpers outside of #[test] functions are too")]

mod common;

use common::{Fusion, Gpu, RANGE_M, Scene, to_reference};
use glam::DVec2;
use itm_core::voxel::{DistanceKind, VoxelKind};
use itm_core::{Image, Intrinsics, Se3};
use itm_gpu::forward::Forward;
use itm_gpu::{RaycastImage, Recorder, reference};
use proptest::prelude::*;

fn room(gpu: &Gpu, kind: VoxelKind) -> Fusion {
    let camera = common::camera(100, 75);
    let mut fusion = Fusion::of_kind(gpu, common::one_camera(camera), 0.03, kind, 4_000);
    for pose in &common::poses() {
        fusion.fuse(gpu, &common::frame(Scene::room().depth(&camera, pose), None), pose);
    }
    fusion
}

/// Projects an image's points to another pose, and casts the rays of the other pixels if told so; the number of those.
fn project(gpu: &Gpu, fusion: &mut Fusion, image: &RaycastImage, pose: &Se3, rays: bool) -> usize {
    let forward = Forward::new(&gpu.device, image.camera());
    fusion.map.lay_grid(image.camera(), pose, RANGE_M[1], 0.2).unwrap();
    let mut recorder = Recorder::new(&gpu.device);
    gpu.allocate.fill_grid(&mut recorder, &fusion.map);
    gpu.visible.record(&mut recorder, &fusion.map, image.camera(), pose, RANGE_M[0], RANGE_M[1]);
    gpu.ranges.record(&mut recorder, &fusion.map, image, pose);
    let missing = forward.record(&mut recorder, image, pose, RANGE_M);
    if rays {
        gpu.raycast.record_listed(&mut recorder, &fusion.map, image, missing, pose, RANGE_M);
    }
    let _untimed = recorder.submit();
    missing.read_len(&gpu.device).unwrap()
}

/// Where a camera sees the points of an image: pixel and depth.
fn seen(points: &Image<[f32; 4]>, camera: &Intrinsics, pose: &Se3) -> Vec<Option<(DVec2, f64)>> {
    let see = |p: glam::DVec3| {
        let p = pose.inverse().transform_point(p);
        camera.project(p).map(|pixel| (pixel, p.z))
    };
    to_reference(points).data().iter().map(|p| p.and_then(see)).collect()
}

proptest! {
    #![proptest_config(common::cases(8))]

    #[test]
    fn each_pixel_gets_the_nearest_point_that_falls_into_it(
        size in prop_oneof![Just((1u32, 1u32)), Just((81, 61)), (1..100u32, 1..80u32)],
        motion in [-0.1..0.1f64, -0.1..0.1, -0.3..0.3, -0.2..0.2, -0.2..0.2, -0.2..0.2],
        negative_fy: bool,
    ) {
        let Some(gpu) = common::gpu() else { return Ok(()) };
        let camera = common::camera(size.0, size.1);
        let camera = if negative_fy { Intrinsics { fy: -camera.fy, ..camera } } else { camera };
        let mut fusion = room(gpu, VoxelKind::default());
        let image = fusion.cast(gpu, camera, &common::poses()[0]);
        let before = image.read_points(&gpu.device).unwrap();
        let pose = common::poses()[0] * Se3::exp(motion);
        let missing = project(gpu, &mut fusion, &image, &pose, false);
        let found = image.read_points(&gpu.device).unwrap();
        prop_assert_eq!(missing, found.data().iter().filter(|p| p[3] == 0.0).count());

        let expected = reference::forward::forward(to_reference(&before).data(), &camera, &pose, RANGE_M);
        let seen = seen(&before, &camera, &pose);
        // A point this near to a pixel's border may be taken for either pixel's, and depths this near for equal.
        let (border, rounding_m) = (1e-3, 1e-5);
        for y in 0..size.1 {
            for x in 0..size.0 {
                let taken = expected[(x, y)].map_or([0.0; 4], |i| before.data()[i]);
                let found = found[(x, y)];
                if found == taken {
                    continue;
                }
                // Another answer is right only where rounding decides.
                let middle = DVec2::new(x.into(), y.into());
                let off = |pixel: DVec2| (pixel - middle).abs().max_element();
                let depth = before.data().iter().zip(&seen).filter(|(p, _)| **p == found && p[3] > 0.0).find_map(|(_, s)| *s);
                if found[3] > 0.0 {
                    let (pixel, _) = depth.expect("one of the points before");
                    prop_assert!(off(pixel) < 0.5 + border, "a point of pixel {pixel} at {middle}");
                }
                let limit = depth.map_or(f64::from(RANGE_M[1]), |(_, z)| z) - rounding_m;
                let nearer = seen.iter().flatten().find(|(pixel, z)| {
                    off(*pixel) < 0.5 - border && *z > f64::from(RANGE_M[0]) + rounding_m && *z < limit
                });
                prop_assert!(nearer.is_none(), "{nearer:?} falls into {middle}, which got {found:?}");
            }
        }
    }
}

#[test]
fn with_the_missing_rays_it_shows_what_a_full_raycast_shows() {
    let Some(gpu) = common::gpu() else { return };
    let kinds = [VoxelKind::default(), VoxelKind { distance: DistanceKind::F32, ..VoxelKind::default() }];
    for kind in kinds {
        let camera = common::camera(81, 61);
        let mut fusion = room(gpu, kind);
        let pose = common::poses()[0] * Se3::exp([0.02, 0.01, 0.0, 0.03, -0.04, 0.02]);
        let full = fusion.cast(gpu, camera, &pose).read_points(&gpu.device).unwrap();
        let image = fusion.cast(gpu, camera, &common::poses()[0]);
        let missing = project(gpu, &mut fusion, &image, &pose, true);
        let found = image.read_points(&gpu.device).unwrap();
        let pixels = found.data().len();
        assert!(missing > pixels / 50 && missing < pixels / 3, "{missing} of {pixels} pixels got no point");
        let (mut both, mut one) = (0, 0);
        for (found, full) in to_reference(&found).data().iter().zip(to_reference(&full).data()) {
            both += usize::from(found.is_some() && full.is_some());
            one += usize::from(found.is_some() != full.is_some());
            let Some(point) = found else { continue };
            assert!(Scene::room().distance(*point) < 0.03, "{point} lies on no surface");
        }
        assert!(both > pixels / 2 && one < pixels / 100, "{both} pixels have a point in both, {one} in one only");
    }
}
