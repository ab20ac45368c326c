// Halves a depth image: the mean of those of a 2x2 group that lie within `reach_m` of its first valid one. Mixing
// foreground and background would make up surfaces that are not there.

struct Params {
    // Of the image that is read.
    size: vec2<u32>,
    // Of the image that is written.
    half_size: vec2<u32>,
    reach_m: f32,
    unused_a: u32,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> depth: array<f32>;
@group(0) @binding(2) var<storage, read_write> halved: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.half_size) {
        return;
    }
    var anchor = 0.0;
    var sum = 0.0;
    var count = 0.0;
    for (var i = 0u; i < 4u; i++) {
        // A side of one pixel has no second one.
        let p = min(2u * id.xy + vec2(i & 1u, i >> 1u), params.size - vec2(1u));
        let z = depth[p.y * params.size.x + p.x];
        if z > 0.0 {
            if anchor == 0.0 {
                anchor = z;
            }
            if abs(z - anchor) <= params.reach_m {
                sum += z;
                count += 1.0;
            }
        }
    }
    halved[id.y * params.half_size.x + id.x] = select(0.0, sum / count, count > 0.0);
}
