// Takes the outermost cells of what is marked away: what noise and the edges of objects leave is narrow (Keller et al. 2013, section on dynamics).
import package::shared::cells::PARTLY_VACANT;

struct Params {
    size: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> marks: array<u32>;
@group(0) @binding(2) var<storage, read_write> eroded: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let size = vec2<i32>(params.size);
    for (var i = id.x; i < params.size.x * params.size.y; i += groups.x * 64u) {
        let cell = vec2(i32(i % params.size.x), i32(i / params.size.x));
        var left = marks[i];
        for (var dy = -1; dy <= 1; dy++) {
            for (var dx = -1; dx <= 1; dx++) {
                let other = cell + vec2(dx, dy);
                // Nothing is known of what lies outside.
                if any(other < vec2(0)) || any(other >= size) {
                    left = 0u;
                } else {
                    left &= marks[u32(other.y) * params.size.x + u32(other.x)];
                }
            }
        }
        eroded[i] = (left & ~PARTLY_VACANT) | (marks[i] & PARTLY_VACANT);
    }
}
