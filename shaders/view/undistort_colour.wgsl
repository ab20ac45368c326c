// Colour of a camera with a lens to that of a pinhole camera with the same intrinsics: each pixel is interpolated
// bilinearly between four of the lens's image. Where that does not show it, or one of the four has no colour, the fourth
// byte is 0: no colour.
import package::shared::camera::Camera;
import package::shared::distortion::{Distortion, distort_pixel, on_image};

struct Params {
    camera: Camera,
    lens: Distortion,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> distorted: array<u32>;
@group(0) @binding(2) var<storage, read_write> colour: array<u32>;

fn texel(x: u32, y: u32) -> vec4<f32> {
    return unpack4x8unorm(distorted[y * params.camera.size.x + x]);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = params.camera.size;
    if any(id.xy >= size) {
        return;
    }
    let source = distort_pixel(params.lens, params.camera, vec2<f32>(id.xy));
    var word = 0u;
    if on_image(params.camera, source) {
        // The outer half of the outermost pixels has their colour.
        let last = vec2<f32>(size - vec2(1u));
        let at = clamp(source, vec2(0.0), last);
        let base = vec2<u32>(at);
        let next = min(base + vec2(1u), size - vec2(1u));
        let f = fract(at);
        let a = texel(base.x, base.y);
        let b = texel(next.x, base.y);
        let c = texel(base.x, next.y);
        let d = texel(next.x, next.y);
        if min(min(a.a, b.a), min(c.a, d.a)) > 0.0 {
            word = pack4x8unorm(vec4(mix(mix(a.rgb, b.rgb, f.x), mix(c.rgb, d.rgb, f.x), f.y), 1.0));
        }
    }
    colour[id.y * size.x + id.x] = word;
}
