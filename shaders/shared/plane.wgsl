// A plane of one word a voxel, in pages: colours or confidences.
import package::shared::map::{Map, BLOCK_VOXELS};

@group(1) @binding(3) var<storage, read> plane0: array<u32>;
@if(pages2) @group(1) @binding(4) var<storage, read> plane1: array<u32>;
@if(pages3) @group(1) @binding(5) var<storage, read> plane2: array<u32>;
@if(pages4) @group(1) @binding(6) var<storage, read> plane3: array<u32>;

// A voxel's word by block index and index within the block.
fn load_word(map: Map, block: u32, voxel: u32) -> u32 {
    let at = (block & ((1u << map.page_shift) - 1u)) * BLOCK_VOXELS + voxel;
    @if(pages2) {
        let page = block >> map.page_shift;
        @if(pages4) { if page == 3u { return plane3[at]; } }
        @if(pages3) { if page == 2u { return plane2[at]; } }
        if page == 1u {
            return plane1[at];
        }
    }
    return plane0[at];
}
