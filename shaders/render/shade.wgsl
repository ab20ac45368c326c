// Colours a raycast image by what is known of its points: grey by their normals, with the light at the camera (Lambert), the
// same with a highlight (Phong), the normals themselves, or depth or confidence on a scale of colours.
import package::shared::shading::{DEPTH, GREY, NORMALS, PHONG, lit, on_scale};

struct Params {
    size: vec2<u32>,
    // As `shared/shading.wgsl` numbers it.
    kind: u32,
    unused_a: u32,
    // The camera's centre (the frame of the points: a submap's, or the world's).
    camera: vec4<f32>,
    // Unit vector along the optical axis (the same frame).
    forward: vec4<f32>,
    // The values at the scale's ends: metres, or observations.
    range: vec2<f32>,
    unused_b: vec2<u32>,
    // The rows of the rotation from the frame of the points to the world's.
    turn_x: vec4<f32>,
    turn_y: vec4<f32>,
    turn_z: vec4<f32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> normals: array<vec4<f32>>;
// Red, green, blue, alpha from the lowest byte up; all zero where the ray hits nothing, or where there is no normal to shade by.
@group(0) @binding(3) var<storage, read_write> image: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixels = params.size.x * params.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        image[i] = pack4x8unorm(colour_of(points[i], normals[i]));
    }
}

fn colour_of(point: vec4<f32>, normal: vec4<f32>) -> vec4<f32> {
    if params.kind == GREY || params.kind == NORMALS || params.kind == PHONG {
        if normal.w == 0.0 {
            return vec4(0.0);
        }
        if params.kind == NORMALS {
            let n = normal.xyz;
            let turned = vec3(dot(params.turn_x.xyz, n), dot(params.turn_y.xyz, n), dot(params.turn_z.xyz, n));
            return vec4(0.5 + 0.5 * turned, 1.0);
        }
        let light = normalize(params.camera.xyz - point.xyz);
        return vec4(lit(params.kind, dot(normal.xyz, light)), 1.0);
    }
    if point.w == 0.0 {
        return vec4(0.0);
    }
    var value = dot(point.xyz - params.camera.xyz, params.forward.xyz);
    if params.kind != DEPTH {
        // What the stage `confidence` found; otherwise the number of observations.
        value = select(point.w - 1.0, normal.w - 2.0, normal.w >= 2.0);
    }
    return vec4(on_scale(value, params.range), 1.0);
}
