// Notes the frame for each visible block, once it was fused into.
import package::shared::map::VISIBLE;

struct Params {
    frame: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counters: array<u32>;
@group(0) @binding(2) var<storage, read> visible: array<u32>;
// Of each block the last frame that changed it; 0 for a block that none has.
@group(0) @binding(3) var<storage, read_write> last_changed: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < counters[VISIBLE]; i += groups.x * 64u) {
        last_changed[visible[i]] = params.frame;
    }
}
