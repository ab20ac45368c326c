// Lists surface points with the colours that the last frame shows there, one for each cell of STRIDE pixels of the model's
// image, for `photometric/sums` (the report, section 3.1.3).
import package::shared::camera::{Camera, project, inside};

struct Params {
    colour_camera: Camera,
    colour_camera_from_world: mat4x4<f32>,
    // Of the model's image.
    size: vec2<u32>,
    // Of the list, as an image.
    list_size: vec2<u32>,
    stride: u32,
    // Points observed less often are left out.
    least_confidence: f32,
    unused: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> image: array<u32>;
// World coordinates (bits of floats), and the colour as four bytes; the last one is 0 where there is no point.
@group(0) @binding(3) var<storage, read_write> list: array<vec4<u32>>;

fn texel(x: u32, y: u32) -> vec4<f32> {
    return unpack4x8unorm(image[y * params.colour_camera.size.x + x]);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let cells = params.list_size.x * params.list_size.y;
    for (var i = id.x; i < cells; i += groups.x * 64u) {
        let cell = vec2(i % params.list_size.x, i / params.list_size.x);
        let at = min(cell * params.stride + vec2(params.stride / 2u), params.size - vec2(1u));
        let point = points[at.y * params.size.x + at.x];
        let p = (params.colour_camera_from_world * vec4(point.xyz, 1.0)).xyz;
        let pixel = project(params.colour_camera, vec3(p.xy, max(p.z, 1e-3)));
        var colour = vec4(0.0);
        if point.w >= params.least_confidence + 1.0 && p.z > 1e-3 && inside(params.colour_camera, pixel) {
            let base = vec2<u32>(pixel);
            let next = min(base + vec2(1u), params.colour_camera.size - vec2(1u));
            let f = pixel - floor(pixel);
            let a = texel(base.x, base.y);
            let b = texel(next.x, base.y);
            let c = texel(base.x, next.y);
            let d = texel(next.x, next.y);
            let whole = f32(min(min(a.w, b.w), min(c.w, d.w)) > 0.0);
            colour = vec4(mix(mix(a, b, f.x), mix(c, d, f.x), f.y).rgb, whole);
        }
        list[i] = vec4(bitcast<vec3<u32>>(point.xyz), pack4x8unorm(colour));
    }
}
