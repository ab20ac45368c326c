// Halves an intensity image: the mean of each 2x2 group, or -1 where one of the four has no colour.

struct Params {
    // Of the image that is read.
    size: vec2<u32>,
    // Of the image that is written.
    half_size: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> intensity: array<f32>;
@group(0) @binding(2) var<storage, read_write> halved: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.half_size) {
        return;
    }
    var sum = 0.0;
    var least = 0.0;
    for (var i = 0u; i < 4u; i++) {
        // A side of one pixel has no second one.
        let p = min(2u * id.xy + vec2(i & 1u, i >> 1u), params.size - vec2(1u));
        let value = intensity[p.y * params.size.x + p.x];
        sum += value;
        least = min(least, value);
    }
    halved[id.y * params.half_size.x + id.x] = select(0.25 * sum, -1.0, least < 0.0);
}
