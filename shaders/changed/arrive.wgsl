// Notes when blocks that came back were last changed: as they say themselves, or by this frame where they met a block that was
// fused into at their place.

struct Params {
    count: u32,
    frame: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
// Index plus one of the block that each became, or zero.
@group(0) @binding(1) var<storage, read> places: array<u32>;
@group(0) @binding(2) var<storage, read> changed: array<u32>;
@group(0) @binding(3) var<storage, read_write> last_changed: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.count; i += groups.x * 64u) {
        if places[i] != 0u {
            let block = places[i] - 1u;
            last_changed[block] = select(params.frame, changed[i], last_changed[block] == 0u);
        }
    }
}
