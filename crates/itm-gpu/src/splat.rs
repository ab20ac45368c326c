//! Stage `splat`: surfels as a camera sees them, each as a disc (Keller et al. 2013, *Real-time 3D Reconstruction in Dynamic
//! Scenes using Point-based Fusion*, section 6).
//!
//! There are more surfels in view than pixels, and of those that lie in one place the best known one is meant. So surfels compete in
//! cells of the size of pixels first (`front`, `keep`); those that are left are laid out as discs (`lay`), which pixels gather from the
//! cells around them (`gather`). Discs that reach farther are rasterised (`nearest`, `choose`), which takes an atomic a pixel.

use itm_core::Intrinsics;
use itm_shaders::splat;

use crate::map::camera_params;
use crate::recorder::{Groups, Pipeline};
use crate::surfels::{BORDER, LARGEST_PX, List, OVER_LIST, SurfelOptions, SurfelView, cells_of, pixel_radius_per_m};
use crate::{Device, RaycastImage, Recorder, SurfelMap};

/// Without and with several submaps.
const COMBINED: [&[&str]; 2] = [&[], &["combined"]];

/// Which surfels are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drawn {
    /// Those of at least this confidence.
    pub least: f32,
    /// Where there are any of at least this one, only those.
    pub preferred: f32,
    /// Of unstable ones only those that this frame, or a later one, has seen last.
    pub since: u32,
    /// Discs are drawn with so many of their radii, and none smaller than what a pixel sees of a surface.
    pub reach: f32,
    /// Pixels that meet no disc show those of the cells around them that they meet within so many of these radii.
    pub fill: f32,
}

/// The stage's pipelines.
#[derive(Debug)]
pub struct Splat {
    list: List,
    /// Of surfels in one frame, and of those of all submaps.
    front: [Pipeline; 2],
    keep: Pipeline,
    lay: [Pipeline; 2],
    nearest: Pipeline,
    gather: Pipeline,
    /// Rows of pixels that an invocation of it goes down.
    strip: u32,
    choose: Pipeline,
    draw: Pipeline,
}

impl Splat {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        let strip = if device.capabilities().software { 16 } else { 4 };
        Self {
            list: List::new(device),
            front: COMBINED.map(|features| Pipeline::over_list(device, &splat::front::PASS, features)),
            keep: Pipeline::over_list(device, &splat::keep::PASS, &[]),
            lay: COMBINED.map(|features| Pipeline::new(device, &splat::lay::PASS, features, &[])),
            nearest: Pipeline::over_list(device, &splat::nearest::PASS, &[]),
            gather: Pipeline::new(device, &splat::gather::PASS, &[], &[("STRIP", strip.into())]),
            strip,
            choose: Pipeline::over_list(device, &splat::choose::PASS, &[]),
            draw: Pipeline::plain(device, &splat::draw::PASS),
        }
    }

    /// Records the image of the surfels from a pose: points, normals, and, in `pixels`, colours.
    ///
    /// # Panics
    /// Where image and `pixels` are not of one camera.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        map: &SurfelMap,
        pixels: &SurfelView,
        image: &RaycastImage,
        options: &SurfelOptions<'_>,
        drawn: Drawn,
    ) {
        recorder.stage("splat");
        let poses = map.camera_from_submaps(options);
        self.list.record(recorder, map, pixels, options, Some(drawn.least), poses.as_ref());
        self.record_listed(recorder, map, pixels, image, options, drawn);
    }

    /// The same from the pose that [`crate::associate`] and [`crate::absorb`] had with these options, whose list holds the surfels in
    /// view already: no other is made.
    ///
    /// # Panics
    /// As [`Splat::record`].
    pub fn record_listed(
        &self,
        recorder: &mut Recorder,
        map: &SurfelMap,
        pixels: &SurfelView,
        image: &RaycastImage,
        options: &SurfelOptions<'_>,
        drawn: Drawn,
    ) {
        recorder.stage("splat");
        assert_eq!(*image.camera(), pixels.camera, "an image of another camera");
        let poses = map.camera_from_submaps(options);
        for (first_row, camera) in pixels.bands() {
            self.record_band(recorder, map, pixels, image, options, drawn, poses.as_ref(), (first_row, &camera));
        }
    }

    /// The same for rows of the image, from a first one on, of which `camera` is the camera.
    #[expect(clippy::too_many_arguments, reason = "it is a part of one function")]
    fn record_band(
        &self,
        recorder: &mut Recorder,
        map: &SurfelMap,
        pixels: &SurfelView,
        image: &RaycastImage,
        options: &SurfelOptions<'_>,
        drawn: Drawn,
        camera_from_submaps: Option<&wgpu::Buffer>,
        (first_row, camera): (u32, &Intrinsics),
    ) {
        let variant = usize::from(camera_from_submaps.is_some());
        let pose = options.world_from_camera;
        let (cells, border) = (cells_of(camera), BORDER);
        // What the pixels keep of measurements is done with.
        let nearest = &pixels.best;
        for buffer in [&pixels.front, &pixels.kept, nearest] {
            recorder.clear(buffer, buffer.size());
        }
        let (room, reach, largest_px) = (map.room(), drawn.reach, LARGEST_PX);
        let (window_m, window_deviations) = (options.settings.window_m, options.settings.window_deviations);
        let preferred = drawn.preferred;
        let params_camera = camera_params(camera, options.depth_range_m);
        let camera_from_world = pose.inverse().to_mat4().to_cols_array_2d();
        let page = map.page();
        for (first, [places, attributes]) in map.each_page() {
            let bindings = splat::front::Bindings {
                params: splat::front::Params {
                    camera: params_camera,
                    camera_from_world,
                    first,
                    page,
                    room,
                    border,
                    preferred,
                    least: drawn.least,
                    since: drawn.since,
                    stable: options.settings.stable,
                },
                counters: &map.counters,
                listed: &map.listed,
                places,
                attributes,
                targets: &map.targets,
                front: &pixels.front,
                camera_from_submaps,
            };
            recorder.dispatch(&self.front[variant], &bindings, OVER_LIST);
        }
        let bindings = splat::keep::Bindings {
            params: splat::keep::Params { room, window_m, window_deviations },
            counters: &map.counters,
            targets: &map.targets,
            front: &pixels.front,
            kept: &pixels.kept,
        };
        recorder.dispatch(&self.keep, &bindings, OVER_LIST);
        let over_cells = Groups::linear(cells.into(), 64);
        let (discs, looks, large) = (&pixels.discs, &pixels.looks, &pixels.large);
        recorder.clear_word(large, 0);
        let width = camera.width + 2 * border;
        for (first, [places, attributes]) in map.each_page() {
            let bindings = splat::lay::Bindings {
                params: splat::lay::Params {
                    camera: params_camera,
                    camera_from_world,
                    first,
                    page,
                    width,
                    cells,
                    border,
                    reach,
                    largest_px,
                    preferred,
                    pixel_radius_per_m: pixel_radius_per_m(camera),
                    unused_a: 0,
                    unused_b: [0; 2],
                },
                kept: &pixels.kept,
                listed: &map.listed,
                places,
                attributes,
                discs,
                looks,
                large,
                camera_from_submaps,
            };
            recorder.dispatch(&self.lay[variant], &bindings, over_cells);
        }
        let params = splat::nearest::Params { camera: params_camera, largest_px, unused_a: 0, unused_b: [0; 2] };
        let bindings = splat::nearest::Bindings { params, large, discs, nearest };
        recorder.dispatch(&self.nearest, &bindings, OVER_LIST);
        let over_pixels = Groups::linear(camera.pixels() as u64, 64);
        let over_strips = Groups::linear((camera.width * camera.height.div_ceil(self.strip)).into(), 64);
        let bindings = splat::gather::Bindings {
            params: splat::gather::Params {
                camera: params_camera,
                width,
                border,
                window_m,
                window_deviations,
                fill: drawn.fill,
                unused_a: 0,
                unused_b: [0; 2],
            },
            discs,
            nearest,
            chosen: &pixels.chosen,
        };
        recorder.dispatch(&self.gather, &bindings, over_strips);
        let params =
            splat::choose::Params { camera: params_camera, largest_px, window_m, window_deviations, unused: 0 };
        let bindings = splat::choose::Bindings { params, large, discs, nearest, chosen: &pixels.chosen };
        recorder.dispatch(&self.choose, &bindings, OVER_LIST);
        let bindings = splat::draw::Bindings {
            params: splat::draw::Params {
                camera: params_camera,
                world_from_camera: pose.to_mat4().to_cols_array_2d(),
                first_pixel: first_row * camera.width,
                unused_a: 0,
                unused_b: [0; 2],
            },
            chosen: &pixels.chosen,
            discs,
            looks,
            points: &image.points,
            normals: &image.normals,
            colours: &pixels.colours,
        };
        recorder.dispatch(&self.draw, &bindings, over_pixels);
    }
}
