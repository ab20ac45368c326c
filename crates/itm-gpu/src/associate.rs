//! Stage `associate`: which surfel each measurement of a view belongs to (Keller et al. 2013, *Real-time 3D Reconstruction in
//! Dynamic Scenes using Point-based Fusion*, sections 4.2 and 5).
//!
//! There, surfels are drawn into an index map of sixteen cells a pixel, so that few hide another of the same pixel. Here each surfel
//! that falls into a pixel is compared with its measurement, and the best of them wins: what an index map of endless resolution
//! would give, without its memory.

use itm_core::Calibration;
use itm_shaders::associate;

use crate::map::camera_params;
use crate::recorder::{Groups, Pipeline};
use crate::surfels::{List, OVER_LIST, SurfelOptions, SurfelView, counter};
use crate::{Device, Recorder, SurfelMap, View};

/// The stage's pipelines.
#[derive(Debug)]
pub struct Associate {
    list: List,
    colour: Pipeline,
    compete: Pipeline,
    choose: Pipeline,
}

impl Associate {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            list: List::new(device),
            colour: Pipeline::plain(device, &associate::colour::PASS),
            compete: Pipeline::over_list(device, &associate::compete::PASS, &[]),
            choose: Pipeline::over_list(device, &associate::choose::PASS, &[]),
        }
    }

    /// Records the stage for a view with vertices and normals from a pose. What it finds lies in `pixels`; surfels that stayed
    /// unstable for too long, or stand in free space, are removed.
    ///
    /// # Panics
    /// Where the view has no vertices.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        map: &SurfelMap,
        view: &View,
        pixels: &SurfelView,
        calibration: &Calibration,
        options: &SurfelOptions<'_>,
    ) {
        recorder.stage("associate");
        let (vertices, normals) = view.vertices().expect("a view for surfels has vertices");
        let settings = options.settings;
        let camera = &pixels.camera;
        counter::OF_FRAME.for_each(|word| recorder.clear_word(&map.counters, word));
        for buffer in [&pixels.best, &pixels.chosen, &pixels.rivals] {
            recorder.clear(buffer, buffer.size());
        }
        self.list.record(recorder, map, pixels, options, None, None);
        let over_pixels = Groups::linear(pixels.pixels().into(), 64);
        match view.colour() {
            Some(image) => {
                let params = associate::colour::Params {
                    camera: camera_params(camera, [0.0; 2]),
                    colour_camera: camera_params(&calibration.colour, [0.0; 2]),
                    colour_from_depth: calibration.colour_from_depth.to_mat4().to_cols_array_2d(),
                };
                let bindings = associate::colour::Bindings { params, vertices, image, colours: &pixels.colours };
                recorder.dispatch(&self.colour, &bindings, over_pixels);
            }
            None => recorder.clear(&pixels.colours, pixels.colours.size()),
        }
        let room = map.room();
        let (window_m, window_deviations) = (settings.window_m, settings.window_deviations);
        let camera_from_world = options.world_from_camera.inverse().to_mat4().to_cols_array_2d();
        for (first, [places, attributes]) in map.each_page() {
            let bindings = associate::compete::Bindings {
                params: associate::compete::Params {
                    camera: camera_params(camera, options.depth_range_m),
                    camera_from_world,
                    first,
                    page: map.page(),
                    room,
                    window_m,
                    window_deviations,
                    least_cosine: settings.max_angle_rad.cos(),
                    free_m: settings.free_m,
                    free_deviations: settings.free_deviations,
                    known: settings.dynamics.fallen,
                    stable: settings.stable,
                    frame: options.frame,
                    patience: settings.patience,
                },
                counters: &map.counters,
                listed: &map.listed,
                places,
                attributes,
                depth: view.depth(),
                normals,
                targets: &map.targets,
                best: &pixels.best,
            };
            recorder.dispatch(&self.compete, &bindings, OVER_LIST);
        }
        for (first, [places, _]) in map.each_page() {
            let bindings = associate::choose::Bindings {
                params: associate::choose::Params { room, first, page: map.page(), stable: settings.stable },
                counters: &map.counters,
                listed: &map.listed,
                targets: &map.targets,
                best: &pixels.best,
                chosen: &pixels.chosen,
                rivals: &pixels.rivals,
                places,
            };
            recorder.dispatch(&self.choose, &bindings, OVER_LIST);
        }
    }
}
