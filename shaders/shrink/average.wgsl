// Shrinks a depth image, or with `colour` a colour image: each pixel of the small image is the mean of what its cell holds.
import package::shared::cell::{cell_of, gather};

struct Params {
    size: vec2<u32>,
    small_size: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
// Metres; 0 where there is none.
@if(!colour) @group(0) @binding(1) var<storage, read> depth: array<f32>;
// Red, green, blue, and a byte that is zero where there is no colour.
@if(colour) @group(0) @binding(2) var<storage, read> colours: array<u32>;
// Mean depth in metres, or colour, 0 to 1, and the share of the cell's pixels that have one.
@group(0) @binding(3) var<storage, read_write> small: array<vec4<f32>>;

// A pixel's value and 1, or zeros.
fn value_at(pixel: u32) -> vec4<f32> {
    @if(!colour) let value = vec4(depth[pixel], 0.0, 0.0, depth[pixel]);
    @if(colour) let value = unpack4x8unorm(colours[pixel]);
    return select(vec4(0.0), vec4(value.xyz, 1.0), value.w > 0.0);
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let cell = cell_of(group.xy, params.size, params.small_size);
    let width = cell.z - cell.x;
    let count = width * (cell.w - cell.y);
    var sum = vec4(0.0);
    for (var i = lane; i < count; i += 64u) {
        sum += value_at((cell.y + i / width) * params.size.x + cell.x + i % width);
    }
    let total = gather(lane, sum);
    if lane == 0u {
        let mean = select(vec3(0.0), total.xyz / total.w, total.w > 0.0);
        small[group.y * params.small_size.x + group.x] = vec4(mean, total.w / f32(count));
    }
}
