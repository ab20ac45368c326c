//! Stage `render`: against its reference on a scene whose depth is known.

mod common;

use itm_core::voxel::VoxelKind;
use itm_core::{ColourImage, Image, Se3};
use itm_gpu::confidence::Confidence;
use itm_gpu::render::{Of, Render, Scale, Seen, Shading};
use itm_gpu::{Canvas, Recorder, reference};

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
        let seen =
            Seen { image: &image, map_from_camera: &pose, world_from_map: &Se3::IDENTITY, of: Of::Voxels(&fusion.map) };
        let scale = Scale { depth_m: [0.5, 2.9], confidence: 3.5 };
        for shading in [Shading::Grey, Shading::Phong, Shading::Normals, Shading::Depth, Shading::Confidence] {
            let painted = render.run(&seen, shading, &scale).unwrap();
            let expected = reference::render::shade(&points, &normals, &pose, shading, &scale);
            for (a, b) in painted.data().iter().zip(expected.data()) {
                assert!((0..4).all(|i| a[i].abs_diff(b[i]) <= 1), "{a:?} instead of {b:?} in {shading:?}");
            }
            let painted_pixels = painted.data().iter().filter(|p| p[3] == 255).count();
            assert!(2 * painted_pixels > camera.pixels(), "{painted_pixels} pixels in {shading:?}");
        }
        // Depth as measured goes to the same place on the scale as the truth, but for half a voxel.
        let painted = render.run(&seen, Shading::Depth, &scale).unwrap();
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

#[test]
fn a_canvas_shows_of_several_maps_what_is_nearest_in_the_worlds_axes() {
    let Some(gpu) = common::gpu() else { return };
    // A width whose rows have to be padded on their way to a texture.
    let camera = common::camera(97, 61);
    let scene = common::Scene::room();
    let poses = common::poses();
    let mut fusion = common::Fusion::of_kind(gpu, common::one_camera(camera), 0.02, VoxelKind::default(), 20_000);
    for pose in &poses {
        fusion.fuse(gpu, &common::frame(scene.depth(&camera, pose), None), pose);
    }
    let render = Render::new(&gpu.device);
    let canvas = Canvas::new(&gpu.device, (camera.width, camera.height)).unwrap();
    let mut recorder = Recorder::new(&gpu.device);
    canvas.clear(&mut recorder);
    let _untimed = recorder.submit();
    let mut expected = ColourImage::filled(camera.width, camera.height, [0; 4]);
    let mut depths = Image::filled(camera.width, camera.height, 0.0_f32);
    // The same map twice: where it is, and turned and moved as another submap would be.
    let turned = Se3::exp([0.1, -0.05, 0.3, 0.1, 0.3, -0.2]);
    let world_from_camera = poses[0];
    let mut differ = 0;
    for world_from_map in [Se3::IDENTITY, turned] {
        let map_from_camera = world_from_map.inverse() * world_from_camera;
        let image = fusion.cast(gpu, camera, &map_from_camera);
        let seen = Seen {
            image: &image,
            map_from_camera: &map_from_camera,
            world_from_map: &world_from_map,
            of: Of::Voxels(&fusion.map),
        };
        let mut recorder = Recorder::new(&gpu.device);
        render.paint(&mut recorder, &seen, Shading::Normals, &Scale::default(), &canvas);
        canvas.show(&mut recorder);
        let _untimed = recorder.submit();
        let points = image.read_points(&gpu.device).unwrap();
        let normals = image.read_normals(&gpu.device).unwrap();
        let in_world = Image::from_fn(camera.width, camera.height, |x, y| {
            let [nx, ny, nz, known] = normals[(x, y)];
            let n = world_from_map.transform_vector(glam::DVec3::new(nx.into(), ny.into(), nz.into())).as_vec3();
            [n.x, n.y, n.z, known]
        });
        let shading = Shading::Normals;
        let picture = reference::render::shade(&points, &in_world, &map_from_camera, shading, &Scale::default());
        let before = expected.clone();
        reference::render::compose(&mut expected, &mut depths, &picture, &points, &map_from_camera);
        differ = before.data().iter().zip(expected.data()).filter(|(a, b)| a != b).count();
    }
    // Some of both is seen.
    assert!((200..camera.pixels() - 200).contains(&differ), "{differ}");
    let painted = canvas.read(&gpu.device).unwrap();
    let wrong = painted.data().iter().zip(expected.data()).filter(|(a, b)| (0..4).any(|i| a[i].abs_diff(b[i]) > 1));
    // Where both are as near, rounding decides.
    assert!(wrong.count() <= 3);
    for pixel in [(0, 0), (48, 30), (96, 60), (20, 50)] {
        let depth = canvas.depth(&gpu.device, pixel).unwrap();
        let truth = Some(depths[pixel]).filter(|depth| *depth > 0.0);
        assert!(depth.is_some() == truth.is_some() && (depth.unwrap_or(0.0) - truth.unwrap_or(0.0)).abs() < 1e-4);
    }
    assert_eq!(canvas.depth(&gpu.device, (97, 0)).unwrap(), None);
}

#[test]
fn a_canvas_without_pixels_is_refused() {
    let Some(gpu) = common::gpu() else { return };
    for size in [(0, 10), (10, 0), (1 << 20, 10)] {
        let error = Canvas::new(&gpu.device, size).unwrap_err().to_string();
        assert!(error.contains(&format!("{}x{}", size.0, size.1)), "{error}");
    }
}
