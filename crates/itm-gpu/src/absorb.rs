//! Stage `absorb`: measurements move the surfels that they belong to, or become surfels (Keller et al. 2013, *Real-time 3D
//! Reconstruction in Dynamic Scenes using Point-based Fusion*, section 4.2; the report, section on surfels).

use itm_shaders::absorb;

use crate::map::camera_params;
use crate::recorder::{Groups, Pipeline};
use crate::scan::{Scan, Total};
use crate::surfels::{OVER_LIST, SurfelOptions, SurfelView, counter, radius_per_m};
use crate::{Device, Recorder, SurfelMap, View};

/// The stage's pipelines.
#[derive(Debug)]
pub struct Absorb {
    update: Pipeline,
    open: Pipeline,
    cover: Pipeline,
    tally: Pipeline,
    insert: Pipeline,
    extend: Pipeline,
    settle: Pipeline,
    dead: Pipeline,
    free: Pipeline,
    scan: Scan,
}

impl Absorb {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        let plain = |pass| Pipeline::plain(device, pass);
        Self {
            update: plain(&absorb::update::PASS),
            open: plain(&absorb::open::PASS),
            cover: plain(&absorb::cover::PASS),
            tally: plain(&absorb::tally::PASS),
            insert: plain(&absorb::insert::PASS),
            extend: plain(&absorb::extend::PASS),
            settle: plain(&absorb::settle::PASS),
            dead: plain(&absorb::dead::PASS),
            free: plain(&absorb::free::PASS),
            scan: Scan::new(device),
        }
    }

    /// Records the stage for a view from the pose that [`crate::associate`] had.
    ///
    /// # Panics
    /// Where the view has no vertices.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        map: &SurfelMap,
        view: &View,
        pixels: &SurfelView,
        options: &SurfelOptions<'_>,
    ) {
        recorder.stage("absorb");
        let (vertices, normals) = view.vertices().expect("a view for surfels has vertices");
        let (settings, frame, page) = (options.settings, options.frame, map.page());
        let camera = camera_params(&pixels.camera, options.depth_range_m);
        let world_from_camera = options.world_from_camera.to_mat4().to_cols_array_2d();
        let (radius_per_m, sigma) = (radius_per_m(&pixels.camera, settings), settings.confidence_sigma);
        let over_pixels = Groups::linear(pixels.pixels().into(), 64);
        let chunks = pixels.chunks();
        let over_chunks = Groups::linear(chunks.into(), 64);
        let (chosen, wanted, open) = (&pixels.chosen, &pixels.wanted, &pixels.open);
        recorder.clear(wanted, wanted.size());
        recorder.clear_word(open, 0);
        let params =
            absorb::open::Params { camera, chunks, least_cosine: settings.max_slant_rad.cos(), unused: [0; 2] };
        let bindings = absorb::open::Bindings { params, vertices, normals, chosen, wanted, open };
        recorder.dispatch(&self.open, &bindings, over_pixels);
        for (first, [places, attributes]) in map.each_page() {
            let bindings = absorb::cover::Bindings {
                params: absorb::cover::Params {
                    camera,
                    world_from_camera,
                    first,
                    page,
                    chunks,
                    window_m: settings.window_m,
                    window_deviations: settings.window_deviations,
                    reach: settings.reach,
                    finer: settings.finer,
                    radius_per_m,
                },
                vertices,
                chosen,
                open,
                places,
                attributes,
                wanted,
            };
            recorder.dispatch(&self.cover, &bindings, OVER_LIST);
        }
        let bindings = absorb::tally::Bindings { params: absorb::tally::Params { chunks }, wanted };
        recorder.dispatch(&self.tally, &bindings, over_chunks);
        for (first, [places, attributes]) in map.each_page() {
            let bindings = absorb::update::Bindings {
                params: absorb::update::Params {
                    camera,
                    world_from_camera,
                    first,
                    page,
                    frame,
                    largest_confidence: settings.max_confidence,
                    radius_per_m,
                    sigma,
                    coarser: settings.coarser,
                    merge_m: settings.merge_m,
                    merge_cosine: settings.merge_rad.cos(),
                    unused_a: 0,
                    unused_b: [0; 2],
                },
                counters: &map.counters,
                vertices,
                normals,
                colours: &pixels.colours,
                chosen: &pixels.chosen,
                rivals: &pixels.rivals,
                places,
                attributes,
            };
            recorder.dispatch(&self.update, &bindings, over_pixels);
        }
        self.record_scan(recorder, map, pixels, &pixels.wanted, chunks, counter::NEW);
        for (first, [places, attributes]) in map.each_page() {
            let bindings = absorb::insert::Bindings {
                params: absorb::insert::Params {
                    camera,
                    world_from_camera,
                    first,
                    page,
                    capacity: map.capacity(),
                    frame,
                    chunks,
                    radius_per_m,
                    sigma,
                    submap: options.part.submap().into(),
                },
                counters: &map.counters,
                vertices,
                normals,
                colours: &pixels.colours,
                wanted: &pixels.wanted,
                free: &map.free,
                places,
                attributes,
            };
            recorder.dispatch(&self.insert, &bindings, over_chunks);
        }
        let params = absorb::extend::Params { capacity: map.capacity(), chunks, room: map.room(), unused: 0 };
        let (counters, wanted, free, listed) = (&map.counters, &pixels.wanted, &map.free, &map.listed);
        let bindings = absorb::extend::Bindings { params, counters, wanted, free, listed };
        recorder.dispatch(&self.extend, &bindings, over_chunks);
        let params = absorb::settle::Params { capacity: map.capacity() };
        let bindings = absorb::settle::Bindings { params, counters: &map.counters };
        recorder.dispatch(&self.settle, &bindings, Groups::Count([1, 1, 1]));
    }

    /// Records that all slots without a surfel are found, so that new ones take them first.
    pub fn record_free(&self, recorder: &mut Recorder, map: &SurfelMap, pixels: &SurfelView) {
        recorder.stage("absorb");
        let page = map.page();
        for (first, [places, _]) in map.each_page() {
            let params = absorb::dead::Params { first, page: page.min(map.capacity() - first) };
            let bindings = absorb::dead::Bindings { params, counters: &map.counters, places, dead: &map.dead };
            recorder.dispatch(&self.dead, &bindings, OVER_LIST);
        }
        self.record_scan(recorder, map, pixels, &map.dead, map.capacity().div_ceil(32), counter::FREE);
        for (first, [places, _]) in map.each_page() {
            let params = absorb::free::Params { first, page };
            let (counters, dead, free) = (&map.counters, &map.dead, &map.free);
            let bindings = absorb::free::Bindings { params, counters, places, dead, free };
            recorder.dispatch(&self.free, &bindings, OVER_LIST);
        }
    }

    fn record_scan(
        &self,
        recorder: &mut Recorder,
        map: &SurfelMap,
        pixels: &SurfelView,
        values: &wgpu::Buffer,
        count: u32,
        slot: u32,
    ) {
        let (counters, indirect) = (&map.counters, &pixels.indirect);
        let total = Total { counters, slot, indirect, indirect_slot: 0, per_group: 64 };
        self.scan.record(recorder, values, count, &total);
    }
}
