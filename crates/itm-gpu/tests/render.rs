//! Stage `render`: against its reference on a scene whose depth is known.

mod common;

use itm_core::voxel::VoxelKind;
use itm_core::{Image, Se3};
use itm_gpu::Recorder;
use itm_gpu::confidence::Confidence;
use itm_gpu::reference;
use itm_gpu::render::{Render, Scale, Shading};

#[test]
fn pictures_are_the_references_and_show_the_true_depth() {
    let Some(gpu) = common::gpu() else { return };
    let camera = common::camera(97, 61);
    let scene = common::Scene::room();
    let poses = common::poses();
    for confidence in [false, true] {
        let kind = VoxelKind { confidence, ..VoxelKind::default() };
        let mut fusion = common::Fusion::of_kind(gpu, common::one_camera(camera), 0.02, kind, 20_000);
        for pose in &poses {
            fusion.fuse(gpu, &common::frame(scene.depth(&camera, pose), None), pose);
        }
        let pose = poses[0] * Se3::exp([0.05, 0.0, -0.02, 0.0, 0.05, 0.0]);
        let image = fusion.cast(gpu, camera, &pose);
        let mut recorder = Recorder::new(&gpu.device);
        Confidence::new(&gpu.device).record(&mut recorder, &fusion.map, &image);
        let _untimed = recorder.submit();
        let points = image.read_points(&gpu.device).unwrap();
        let normals = image.read_normals(&gpu.device).unwrap();
        let render = Render::new(&gpu.device);
        let scale = Scale { depth_m: [0.5, 2.9], confidence: 3.5 };
        for shading in [Shading::Grey, Shading::Phong, Shading::Normals, Shading::Depth, Shading::Confidence] {
            let painted = render.run(&fusion.map, &image, &pose, shading, &scale).unwrap();
            let expected = reference::render::shade(&points, &normals, &pose, shading, &scale);
            for (a, b) in painted.data().iter().zip(expected.data()) {
                assert!((0..4).all(|i| a[i].abs_diff(b[i]) <= 1), "{a:?} instead of {b:?} in {shading:?}");
            }
            let painted_pixels = painted.data().iter().filter(|p| p[3] == 255).count();
            assert!(2 * painted_pixels > camera.pixels(), "{painted_pixels} pixels in {shading:?}");
        }
        // Depth as measured goes to the same place on the scale as the truth, but for half a voxel.
        let painted = render.run(&fusion.map, &image, &pose, Shading::Depth, &scale).unwrap();
        let truth = scene.depth(&camera, &pose);
        let in_front = Image::from_fn(camera.width, camera.height, |x, y| {
            let p = pose.transform_point(camera.unproject(glam::DVec2::new(x.into(), y.into()), truth[(x, y)].into()));
            [p.x as f32, p.y as f32, p.z as f32, 1.0]
        });
        let expected = reference::render::shade(&in_front, &in_front, &pose, Shading::Depth, &scale);
        let pairs = painted.data().iter().zip(expected.data()).filter(|(a, _)| a[3] == 255);
        let off: Vec<f64> =
            pairs.map(|(a, b)| (0..3).map(|i| f64::from(a[i].abs_diff(b[i]))).fold(0.0, f64::max)).collect();
        assert!(common::quantile(off, 0.9) <= 4.0);
    }
}
