//! Exclusive prefix sums.

use itm_shaders::scan;

use crate::recorder::{Groups, Pipeline};
use crate::{Device, Recorder};

/// Exclusive prefix sums over buffers of counts.
#[derive(Debug)]
pub(crate) struct Scan {
    pipeline: Pipeline,
}

/// Where a scan's total goes.
pub(crate) struct Total<'a> {
    pub(crate) counters: &'a wgpu::Buffer,
    pub(crate) slot: u32,
    pub(crate) indirect: &'a wgpu::Buffer,
    pub(crate) indirect_slot: u32,
    /// Items that one workgroup of the indirect dispatch takes.
    pub(crate) per_group: u32,
}

impl Scan {
    pub(crate) fn new(device: &Device) -> Self {
        Self { pipeline: Pipeline::plain(device, &scan::PASS) }
    }

    /// Replaces the first `count` values by the sums of those before them.
    pub(crate) fn record(&self, recorder: &mut Recorder, values: &wgpu::Buffer, count: u32, total: &Total<'_>) {
        let bindings = scan::Bindings {
            params: scan::Params {
                count,
                total_slot: total.slot,
                indirect_slot: total.indirect_slot,
                divisor: total.per_group,
            },
            values,
            counters: total.counters,
            indirect: total.indirect,
        };
        recorder.dispatch(&self.pipeline, &bindings, Groups::Count([1, 1, 1]));
    }
}
