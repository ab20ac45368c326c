// The cells of an image that is shrunk, and sums over one of them by a workgroup of 64.

var<workgroup> sums: array<vec4<f32>, 64>;

// First pixel, and the one behind the last, that a pixel of the small image stands for: at least one pixel.
fn cell_of(pixel: vec2<u32>, size: vec2<u32>, small_size: vec2<u32>) -> vec4<u32> {
    let first = pixel * size / small_size;
    let behind = (pixel + 1u) * size / small_size;
    return vec4(first, max(behind, first + 1u));
}

// The sum of all lanes' values, in a fixed tree; for lane 0.
fn gather(lane: u32, value: vec4<f32>) -> vec4<f32> {
    sums[lane] = value;
    for (var half = 32u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if lane < half {
            sums[lane] += sums[lane + half];
        }
    }
    return sums[0];
}
