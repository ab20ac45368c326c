// The colour of each measurement, where the colour camera sees it (0 where it does not).
import package::shared::camera::{Camera, project, inside};

struct Params {
    camera: Camera,
    colour_camera: Camera,
    colour_from_depth: mat4x4<f32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> vertices: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> image: array<u32>;
// From the lowest byte up, the highest 255 where there is one.
@group(0) @binding(3) var<storage, read_write> colours: array<u32>;

fn texel(x: u32, y: u32) -> vec4<f32> {
    return unpack4x8unorm(image[y * params.colour_camera.size.x + x]);
}

fn colour_of(vertex: vec4<f32>) -> vec4<f32> {
    let p = (params.colour_from_depth * vec4(vertex.xyz, 1.0)).xyz;
    if vertex.w == 0.0 || p.z <= 0.0 {
        return vec4(0.0);
    }
    let pixel = project(params.colour_camera, p);
    if !inside(params.colour_camera, pixel) {
        return vec4(0.0);
    }
    let base = vec2<u32>(pixel);
    let f = pixel - floor(pixel);
    let next = min(base + vec2(1u), params.colour_camera.size - vec2(1u));
    let a = texel(base.x, base.y);
    let b = texel(next.x, base.y);
    let c = texel(base.x, next.y);
    let d = texel(next.x, next.y);
    // A fourth byte of 0 marks pixels without a colour.
    if min(min(a.a, b.a), min(c.a, d.a)) == 0.0 {
        return vec4(0.0);
    }
    return vec4(mix(mix(a.rgb, b.rgb, f.x), mix(c.rgb, d.rgb, f.x), f.y), 1.0);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixels = params.camera.size.x * params.camera.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        colours[i] = pack4x8unorm(colour_of(vertices[i]));
    }
}
