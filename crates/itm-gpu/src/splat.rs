//! Stage `splat`: surfels as a camera sees them, each as a disc (Keller et al. 2013, *Real-time 3D Reconstruction in Dynamic
//! Scenes using Point-based Fusion*, section 6).

use itm_shaders::splat;

use crate::map::camera_params;
use crate::recorder::{Groups, Pipeline};
use crate::surfels::{LARGEST_PX, List, OVER_LIST, SurfelOptions, SurfelView};
use crate::{Device, RaycastImage, Recorder, SurfelMap};

/// Which surfels are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drawn {
    /// Those of at least this confidence.
    pub least: f32,
    /// Where there are any of at least this one, only those.
    pub preferred: f32,
    /// Of unstable ones only those that this frame, or a later one, has seen last.
    pub since: u32,
    /// Discs are drawn with so many of their radii.
    pub reach: f32,
}

/// The stage's pipelines.
#[derive(Debug)]
pub struct Splat {
    list: List,
    /// Of surfels in one frame, and of those of all submaps.
    nearest: [Pipeline; 2],
    choose: [Pipeline; 2],
    draw: [Pipeline; 2],
}

impl Splat {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        let both = |pass| [&[][..], &["combined"]].map(|features| Pipeline::new(device, pass, features, &[]));
        Self {
            list: List::new(device),
            nearest: both(&splat::nearest::PASS),
            choose: both(&splat::choose::PASS),
            draw: both(&splat::draw::PASS),
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
        let camera = image.camera();
        assert_eq!(*camera, pixels.camera, "an image of another camera");
        let poses = map.camera_from_submaps(options);
        let (camera_from_submaps, variant) = (poses.as_ref(), usize::from(poses.is_some()));
        let pose = options.world_from_camera;
        // What the pixels keep of measurements is done with.
        let nearest = &pixels.best;
        for buffer in [&pixels.chosen, nearest] {
            recorder.clear(buffer, buffer.size());
        }
        let (room, reach, largest_px) = (map.room(), drawn.reach, LARGEST_PX);
        let (window_m, preferred) = (options.settings.window_m, drawn.preferred);
        let params_camera = camera_params(camera, options.depth_range_m);
        let camera_from_world = pose.inverse().to_mat4().to_cols_array_2d();
        let page = map.page();
        for (first, [places, attributes]) in map.each_page() {
            let bindings = splat::nearest::Bindings {
                params: splat::nearest::Params {
                    camera: params_camera,
                    camera_from_world,
                    first,
                    page,
                    room,
                    reach,
                    largest_px,
                    preferred,
                    least: drawn.least,
                    since: drawn.since,
                    stable: options.settings.stable,
                    unused_a: 0,
                    unused_b: [0; 2],
                },
                counters: &map.counters,
                listed: &map.listed,
                places,
                attributes,
                nearest,
                camera_from_submaps,
            };
            recorder.dispatch(&self.nearest[variant], &bindings, OVER_LIST);
        }
        for (first, [places, attributes]) in map.each_page() {
            let bindings = splat::choose::Bindings {
                params: splat::choose::Params {
                    camera: params_camera,
                    camera_from_world,
                    first,
                    page,
                    room,
                    reach,
                    largest_px,
                    window_m,
                    window_deviations: options.settings.window_deviations,
                    preferred,
                    least: drawn.least,
                    since: drawn.since,
                    stable: options.settings.stable,
                    unused: 0,
                },
                counters: &map.counters,
                listed: &map.listed,
                places,
                attributes,
                nearest,
                chosen: &pixels.chosen,
                camera_from_submaps,
            };
            recorder.dispatch(&self.choose[variant], &bindings, OVER_LIST);
        }
        for (first, [places, attributes]) in map.each_page() {
            let bindings = splat::draw::Bindings {
                params: splat::draw::Params {
                    camera: params_camera,
                    camera_from_world,
                    world_from_camera: pose.to_mat4().to_cols_array_2d(),
                    first,
                    page,
                    unused: [0; 2],
                },
                chosen: &pixels.chosen,
                listed: &map.listed,
                places,
                attributes,
                points: &image.points,
                normals: &image.normals,
                colours: &pixels.colours,
                camera_from_submaps,
            };
            recorder.dispatch(&self.draw[variant], &bindings, Groups::linear(pixels.pixels().into(), 64));
        }
    }
}
