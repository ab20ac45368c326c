//! Maps that are filled with some blocks, used, and filled with others.

use crate::BlockMap;
use crate::map::COUNTERS;

impl BlockMap {
    /// Forgets all blocks, and what waits; the pools stay as large as they are. What the voxels held is overwritten only by
    /// what [`BlockMap::insert_blocks`] brings next: nothing may be allocated in a map that was emptied so.
    pub fn forget_blocks(&mut self) {
        let counters = [0_u32; COUNTERS as usize];
        self.device().queue.write_buffer(&self.counters, 0, bytemuck::cast_slice(&counters));
    }
}
