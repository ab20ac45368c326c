// Smooths a small image by a Gaussian, over the pixels that hold something. A pixel whose cell is less than half filled stays
// empty, so that the share of what is seen is not blurred.

struct Params {
    size: vec2<u32>,
    // Standard deviation in pixels; 0 for none.
    sigma: f32,
    reach: i32,
}

@group(0) @binding(0) var<uniform> params: Params;
// A value of three numbers, and the share of the cell that has one.
@group(0) @binding(1) var<storage, read> small: array<vec4<f32>>;
// The smoothed value and 1, or zeros.
@group(0) @binding(2) var<storage, read_write> smooth_image: array<vec4<f32>>;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.size) {
        return;
    }
    let at = id.y * params.size.x + id.x;
    if small[at].w < 0.5 {
        smooth_image[at] = vec4(0.0);
        return;
    }
    let middle = vec2<i32>(id.xy);
    let first = max(middle - params.reach, vec2(0));
    let last = min(middle + params.reach, vec2<i32>(params.size) - 1);
    var sum = vec4(0.0);
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            let value = small[u32(y) * params.size.x + u32(x)];
            let off = vec2<f32>(vec2(x, y) - middle);
            var weight = value.w;
            if params.sigma > 0.0 {
                weight *= exp(-0.5 * dot(off, off) / (params.sigma * params.sigma));
            }
            sum += weight * vec4(value.xyz, 1.0);
        }
    }
    smooth_image[at] = vec4(sum.xyz / sum.w, 1.0);
}
