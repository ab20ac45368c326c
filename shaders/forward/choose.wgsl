// Which point each pixel gets: the nearest of those that fall into it, and of several at the same depth the first.

struct Params {
    pixels: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> targets: array<vec2<u32>>;
@group(0) @binding(2) var<storage, read> nearest: array<u32>;
// The complement of the point's index; zeroed memory has none.
@group(0) @binding(3) var<storage, read_write> chosen: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < params.pixels; i += groups.x * 64u) {
        let goal = targets[i];
        if goal.x != 0u && nearest[goal.x - 1u] == ~goal.y {
            atomicMax(&chosen[goal.x - 1u], ~i);
        }
    }
}
