//! Stage `segment`: what of a view moves, and what has left (Keller et al. 2013, *Real-time 3D Reconstruction in Dynamic Scenes using
//! Point-based Fusion*, section on dynamics). Stable surfels there become unstable, so that they vanish unless they are observed again.
//!
//! There, what moves grows from the points that have no correspondence. Here it grows from measurements in front of the stable
//! surface that was seen last: what stands behind it says that something has left, and not that the wall that is seen now moves. What has
//! left is found by the surfels that `associate` found to be in front of measurements.

use itm_core::{DynamicsSettings, Image, Intrinsics, Se3};
use itm_shaders::segment;

use crate::map::camera_params;
use crate::recorder::{Groups, Pipeline};
use crate::surfels::{OVER_LIST, SurfelOptions};
use crate::{Device, Error, RaycastImage, Recorder, SurfelMap, View};

/// What a finest cell of an image shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellMarks {
    /// What is measured there moves.
    pub dynamic: bool,
    /// What was there has left.
    pub vacant: bool,
}

/// Cells of an image, on several levels, and what of it moves.
#[derive(Debug)]
pub struct Segmentation {
    camera: Intrinsics,
    cell_px: u32,
    /// For each pixel whether it sees through a surfel.
    vacant: wgpu::Buffer,
    levels: Vec<Level>,
    /// Which marks of the finest level are the last ones.
    last: usize,
}

/// Cells of one size.
#[derive(Debug)]
struct Level {
    size: [u32; 2],
    /// Camera frame, metres; the fourth number is 1, or 0 where there is none.
    places: wgpu::Buffer,
    normals: wgpu::Buffer,
    /// Read and written in turn.
    marks: [wgpu::Buffer; 2],
}

impl Level {
    fn new(device: &Device, size: [u32; 2]) -> Self {
        let cells = u64::from(size[0]) * u64::from(size[1]);
        Self {
            size,
            places: device.storage("cells' places", cells * 16),
            normals: device.storage("cells' normals", cells * 16),
            marks: ["cells' marks", "cells' other marks"].map(|label| device.storage(label, cells * 4)),
        }
    }

    fn groups(&self) -> Groups<'static> {
        Groups::linear(u64::from(self.size[0]) * u64::from(self.size[1]), 64)
    }
}

impl Segmentation {
    /// Cells of a camera's views.
    pub fn new(device: &Device, camera: Intrinsics, settings: &DynamicsSettings) -> Self {
        let cell_px = settings.cell_px.max(1);
        let finest = [camera.width, camera.height].map(|side| side.div_ceil(cell_px));
        let levels = (0..settings.levels.max(1)).scan(finest, |size, _| {
            let own = *size;
            *size = size.map(|side| side.div_ceil(2));
            Some(Level::new(device, own))
        });
        Self {
            camera,
            cell_px,
            vacant: device.storage("vacant pixels", camera.pixels() as u64 * 4),
            levels: levels.collect(),
            last: (settings.erosion as usize + settings.iterations as usize) % 2,
        }
    }

    /// Reads the marks of the finest cells back. Waits. For tests and pictures.
    ///
    /// # Errors
    /// Where the device was lost.
    pub fn read(&self, device: &Device) -> Result<Image<CellMarks>, Error> {
        let finest = &self.levels[0];
        let [width, height] = finest.size;
        let marks = device.read::<u32>(&finest.marks[self.last], 0, u64::from(width) * u64::from(height) * 4)?;
        let cells = marks.iter().map(|word| CellMarks { dynamic: word & 1 != 0, vacant: word & 2 != 0 });
        Ok(Image::new(width, height, cells.collect()).expect("as many marks as cells"))
    }
}

/// The stage's pipelines.
#[derive(Debug)]
pub struct Segment {
    vacate: Pipeline,
    cells: Pipeline,
    erode: Pipeline,
    coarsen: Pipeline,
    grow: Pipeline,
    refine: Pipeline,
    demote: Pipeline,
}

impl Segment {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        let plain = |pass| Pipeline::plain(device, pass);
        Self {
            vacate: plain(&segment::vacate::PASS),
            cells: plain(&segment::cells::PASS),
            erode: plain(&segment::erode::PASS),
            coarsen: plain(&segment::coarsen::PASS),
            grow: plain(&segment::grow::PASS),
            refine: plain(&segment::refine::PASS),
            demote: plain(&segment::demote::PASS),
        }
    }

    /// Records the stage for a view that [`crate::associate`] has just been recorded for, from the same pose. `model` is what was seen of
    /// the map from the pose `world_from_model`.
    ///
    /// # Panics
    /// Where the view has no vertices, or view, model and cells are not of one camera.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        map: &SurfelMap,
        view: &View,
        segmentation: &Segmentation,
        (model, world_from_model): (&RaycastImage, &Se3),
        options: &SurfelOptions<'_>,
    ) {
        recorder.stage("segment");
        let (vertices, normals) = view.vertices().expect("a view for surfels has vertices");
        assert_eq!(model.camera(), &segmentation.camera, "a model of another camera");
        let (settings, stable) = (&options.settings.dynamics, options.settings.stable);
        let levels = &segmentation.levels;
        let room = map.room();
        let (alike_m, alike_deviations) = (settings.alike_m, settings.alike_deviations);
        let least_cosine = settings.alike_rad.cos();
        recorder.clear(&segmentation.vacant, segmentation.vacant.size());
        let bindings = segment::vacate::Bindings {
            params: segment::vacate::Params { room },
            counters: &map.counters,
            targets: &map.targets,
            vacant: &segmentation.vacant,
        };
        recorder.dispatch(&self.vacate, &bindings, OVER_LIST);
        let model_from_world = world_from_model.inverse();
        let model_from_camera = model_from_world * *options.world_from_camera;
        let finest = &levels[0];
        let bindings = segment::cells::Bindings {
            params: segment::cells::Params {
                camera: camera_params(&segmentation.camera, options.depth_range_m),
                model_from_camera: model_from_camera.to_mat4().to_cols_array_2d(),
                model_from_world: model_from_world.to_mat4().to_cols_array_2d(),
                size: finest.size,
                side: segmentation.cell_px,
                gate_m: settings.gate_m,
                gate_deviations: settings.gate_deviations,
                stable,
                least_share: settings.min_share,
                alike_m,
                alike_deviations,
                unused_a: 0,
                unused_b: [0; 2],
            },
            vertices,
            normals,
            model: &model.points,
            vacant: &segmentation.vacant,
            places: &finest.places,
            facings: &finest.normals,
            marks: &finest.marks[0],
        };
        recorder.dispatch(&self.cells, &bindings, finest.groups());
        // Of each level which marks are the newest.
        let mut newest = vec![0; levels.len()];
        for _ in 0..settings.erosion {
            let bindings = segment::erode::Bindings {
                params: segment::erode::Params { size: finest.size },
                marks: &finest.marks[newest[0]],
                eroded: &finest.marks[1 - newest[0]],
            };
            recorder.dispatch(&self.erode, &bindings, finest.groups());
            newest[0] = 1 - newest[0];
        }
        for (at, pair) in levels.windows(2).enumerate() {
            let [fine, coarse] = pair else { continue };
            let bindings = segment::coarsen::Bindings {
                params: segment::coarsen::Params {
                    size: fine.size,
                    half_size: coarse.size,
                    alike_m,
                    alike_deviations,
                    least_cosine,
                    unused: 0,
                },
                places: &fine.places,
                facings: &fine.normals,
                marks: &fine.marks[newest[at]],
                coarse_places: &coarse.places,
                coarse_facings: &coarse.normals,
                coarse_marks: &coarse.marks[0],
            };
            recorder.dispatch(&self.coarsen, &bindings, coarse.groups());
        }
        for (at, level) in levels.iter().enumerate().rev() {
            if let Some(coarse) = levels.get(at + 1) {
                let bindings = segment::refine::Bindings {
                    params: segment::refine::Params {
                        size: level.size,
                        half_size: coarse.size,
                        alike_m,
                        alike_deviations,
                        least_cosine,
                        unused: 0,
                    },
                    places: &level.places,
                    facings: &level.normals,
                    marks: &level.marks[newest[at]],
                    coarse_places: &coarse.places,
                    coarse_facings: &coarse.normals,
                    coarse_marks: &coarse.marks[newest[at + 1]],
                };
                recorder.dispatch(&self.refine, &bindings, level.groups());
            }
            for _ in 0..settings.iterations {
                let bindings = segment::grow::Bindings {
                    params: segment::grow::Params {
                        size: level.size,
                        alike_m,
                        alike_deviations,
                        least_cosine,
                        unused: 0,
                    },
                    places: &level.places,
                    facings: &level.normals,
                    marks: &level.marks[newest[at]],
                    grown: &level.marks[1 - newest[at]],
                };
                recorder.dispatch(&self.grow, &bindings, level.groups());
                newest[at] = 1 - newest[at];
            }
        }
        debug_assert_eq!(newest[0], segmentation.last, "other settings than the cells were made for");
        for (first, [places, _]) in map.each_page() {
            let bindings = segment::demote::Bindings {
                params: segment::demote::Params {
                    camera: camera_params(&segmentation.camera, options.depth_range_m),
                    camera_from_world: options.world_from_camera.inverse().to_mat4().to_cols_array_2d(),
                    size: finest.size,
                    side: segmentation.cell_px,
                    room,
                    first,
                    page: map.page(),
                    stable,
                    fallen: settings.fallen,
                    window_m: options.settings.window_m,
                    window_deviations: options.settings.window_deviations,
                    unused: [0; 2],
                },
                counters: &map.counters,
                listed: &map.listed,
                targets: &map.targets,
                shown: &finest.places,
                facings: &finest.normals,
                marks: &finest.marks[newest[0]],
                places,
            };
            recorder.dispatch(&self.demote, &bindings, OVER_LIST);
        }
    }
}
