//! Stage `allocate`: new blocks where the frame's depth asks for them (the report, section 3.2).
//!
//! Requests are deduplicated in a bitmap over the grid around the view, numbered by prefix sum and inserted, so that
//! nothing depends on which invocation comes first and colliding keys all find their place in the same frame.

use itm_core::Se3;
use itm_shaders::allocate;

use crate::map::{PENDING_CAPACITY, camera_params, counter, indirect};
use crate::recorder::{Groups, Pipeline};
use crate::scan::{Scan, Total};
use crate::swap::Arrivals;
use crate::{BlockMap, Device, Recorder, View};

/// The stage's pipelines.
#[derive(Debug)]
pub struct Allocate {
    fill_grid: Pipeline,
    request: Pipeline,
    arrive: Pipeline,
    retry: Pipeline,
    count: Pipeline,
    scan: Scan,
    insert: Pipeline,
    commit: Pipeline,
}

impl Allocate {
    /// Compiles the stage.
    pub fn new(device: &Device) -> Self {
        Self {
            fill_grid: Pipeline::plain(device, &allocate::fill_grid::PASS),
            request: Pipeline::plain(device, &allocate::request::PASS),
            arrive: Pipeline::plain(device, &allocate::arrive::PASS),
            retry: Pipeline::plain(device, &allocate::retry::PASS),
            count: Pipeline::plain(device, &allocate::count::PASS),
            scan: Scan::new(device),
            insert: Pipeline::plain(device, &allocate::insert::PASS),
            commit: Pipeline::plain(device, &allocate::commit::PASS),
        }
    }

    /// Records filling the grid with the blocks that it covers. Part of [`Allocate::record`]; on its own for views in
    /// which nothing is allocated.
    pub fn fill_grid(&self, recorder: &mut Recorder, map: &BlockMap) {
        recorder.stage("allocate");
        recorder.clear(&map.grid, u64::from(map.cells()) * 4);
        let bindings = allocate::fill_grid::Bindings {
            params: allocate::fill_grid::Params { map: map.params() },
            counters: &map.counters,
            keys: &map.keys,
            cells: &map.grid,
        };
        recorder.dispatch(&self.fill_grid, &bindings, Groups::linear(map.capacity().into(), 64));
    }

    /// Records the whole stage for a view's depth seen from a pose. The grid must have been laid around that view.
    pub fn record(&self, recorder: &mut Recorder, map: &BlockMap, view: &View, world_from_camera: &Se3) {
        self.record_with(recorder, map, Some((view, world_from_camera)), None);
    }

    /// The same, also with room for blocks that come from the host, or for those alone.
    pub fn record_with(
        &self,
        recorder: &mut Recorder,
        map: &BlockMap,
        view: Option<(&View, &Se3)>,
        arrivals: Option<&Arrivals>,
    ) {
        self.fill_grid(recorder, map);
        let words = map.cells().div_ceil(32);
        let chunks = words.div_ceil(32);
        recorder.clear(&map.requests, u64::from(words) * 4);
        if let Some((view, world_from_camera)) = view {
            let camera = view.level_camera(0);
            let bindings = allocate::request::Bindings {
                params: allocate::request::Params {
                    camera: camera_params(camera, [0.0, 0.0]),
                    world_from_camera: world_from_camera.to_mat4().to_cols_array_2d(),
                    map: map.params(),
                },
                depth: view.depth(),
                cells: &map.grid,
                requests: &map.requests,
            };
            recorder.dispatch(&self.request, &bindings, Groups::image((camera.width, camera.height), (64, 1)));
        }
        if let Some(arrivals) = arrivals {
            let count = arrivals.count();
            let bindings = allocate::arrive::Bindings {
                params: allocate::arrive::Params { map: map.params(), count, unused_a: 0, unused_b: [0; 2] },
                arriving: arrivals.keys(),
                cells: &map.grid,
                requests: &map.requests,
            };
            recorder.dispatch(&self.arrive, &bindings, Groups::linear(count.into(), 64));
        }
        let bindings = allocate::retry::Bindings {
            params: allocate::retry::Params { map: map.params() },
            counters: &map.counters,
            pending: &map.pending,
            cells: &map.grid,
            requests: &map.requests,
        };
        recorder.dispatch(&self.retry, &bindings, Groups::Count([1, 1, 1]));
        let bindings = allocate::count::Bindings {
            params: allocate::count::Params { words, chunks },
            requests: &map.requests,
            counts: &map.request_counts,
        };
        recorder.dispatch(&self.count, &bindings, Groups::linear(chunks.into(), 64));
        let total = Total {
            counters: &map.counters,
            slot: counter::REQUESTED,
            indirect: &map.indirect,
            indirect_slot: indirect::SCRATCH,
            per_group: 64,
        };
        self.scan.record(recorder, &map.request_counts, chunks, &total);
        let bindings = allocate::insert::Bindings {
            params: allocate::insert::Params {
                map: map.params(),
                words,
                chunks,
                pending_capacity: PENDING_CAPACITY,
                unused: 0,
            },
            counters: &map.counters,
            requests: &map.requests,
            offsets: &map.request_counts,
            free_blocks: &map.free_blocks,
            keys: &map.keys,
            cells: &map.grid,
            pending: &map.pending,
            slots: &map.hash,
        };
        recorder.dispatch(&self.insert, &bindings, Groups::linear(chunks.into(), 64));
        let bindings = allocate::commit::Bindings {
            params: allocate::commit::Params { capacity: map.capacity(), pending_capacity: PENDING_CAPACITY },
            counters: &map.counters,
        };
        recorder.dispatch(&self.commit, &bindings, Groups::Count([1, 1, 1]));
    }
}
