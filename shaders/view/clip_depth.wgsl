// Depth that comes in metres: what is out of range, or not a number, becomes 0.

struct Params {
    size: vec2<u32>,
    near_m: f32,
    far_m: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> metres: array<f32>;
@group(0) @binding(2) var<storage, read_write> depth: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixels = params.size.x * params.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        let z = metres[i];
        depth[i] = select(0.0, z, z >= params.near_m && z <= params.far_m);
    }
}
