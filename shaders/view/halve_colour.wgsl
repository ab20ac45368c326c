// Halves a colour image: the mean of each 2x2 group; a group with a pixel that has no colour (fourth byte 0) has none.

struct Params {
    // Of the image that is read.
    size: vec2<u32>,
    // Of the image that is written.
    half_size: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> colour: array<u32>;
@group(0) @binding(2) var<storage, read_write> halved: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.half_size) {
        return;
    }
    var sum = vec4(0.0);
    var least = 1.0;
    for (var i = 0u; i < 4u; i++) {
        // A side of one pixel has no second one.
        let p = min(2u * id.xy + vec2(i & 1u, i >> 1u), params.size - vec2(1u));
        let texel = unpack4x8unorm(colour[p.y * params.size.x + p.x]);
        sum += texel;
        least = min(least, texel.w);
    }
    halved[id.y * params.half_size.x + id.x] = pack4x8unorm(select(vec4(0.0), 0.25 * sum, least > 0.0));
}
