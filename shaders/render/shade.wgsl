// Colours a raycast image by what is known of its points: grey by their normals, with the light at the camera (Lambert), the
// same with a highlight (Phong), the normals themselves, or depth or confidence on a scale of colours.

struct Params {
    size: vec2<u32>,
    // 0: shaded grey. 1: normals. 2: depth. 3: confidence. 4: grey with a highlight.
    kind: u32,
    unused_a: u32,
    // The camera's centre (world frame).
    camera: vec4<f32>,
    // Unit vector along the optical axis (world frame).
    forward: vec4<f32>,
    // The values at the scale's ends: metres, or observations.
    range: vec2<f32>,
    unused_b: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> normals: array<vec4<f32>>;
// Red, green, blue, alpha from the lowest byte up; all zero where the ray hits nothing, or where there is no normal to shade by.
@group(0) @binding(3) var<storage, read_write> image: array<u32>;

const GREY: u32 = 0u;
const NORMALS: u32 = 1u;
const DEPTH: u32 = 2u;
const PHONG: u32 = 4u;
const SHININESS: f32 = 20.0;

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
            return vec4(0.5 + 0.5 * normal.xyz, 1.0);
        }
        let light = normalize(params.camera.xyz - point.xyz);
        let facing = min(abs(dot(normal.xyz, light)), 1.0);
        if params.kind == PHONG {
            // Light and eye are one, so that the reflected ray's angle to the eye is twice the light's to the normal.
            let mirrored = max(2.0 * facing * facing - 1.0, 0.0);
            return vec4(vec3(0.1 + 0.6 * facing + 0.3 * pow(mirrored, SHININESS)), 1.0);
        }
        return vec4(vec3(0.15 + 0.8 * facing), 1.0);
    }
    if point.w == 0.0 {
        return vec4(0.0);
    }
    var value = dot(point.xyz - params.camera.xyz, params.forward.xyz);
    if params.kind != DEPTH {
        // What the stage `confidence` found; otherwise the number of observations.
        value = select(point.w - 1.0, normal.w - 2.0, normal.w >= 2.0);
    }
    let share = (value - params.range.x) / (params.range.y - params.range.x);
    return vec4(scale_colour(clamp(share, 0.0, 1.0)), 1.0);
}

// The scale 'viridis' (Smith & van der Walt, CC0), from dark blue over green to yellow, in nine steps with straight lines
// between.
fn scale_colour(share: f32) -> vec3<f32> {
    var steps = array<vec3<f32>, 9>(
        vec3(68.0, 1.0, 84.0),
        vec3(71.0, 44.0, 122.0),
        vec3(59.0, 81.0, 139.0),
        vec3(44.0, 113.0, 142.0),
        vec3(33.0, 144.0, 141.0),
        vec3(39.0, 173.0, 129.0),
        vec3(92.0, 200.0, 99.0),
        vec3(170.0, 220.0, 50.0),
        vec3(253.0, 231.0, 37.0),
    );
    let place = share * 8.0;
    let below = min(u32(place), 7u);
    return mix(steps[below], steps[below + 1u], place - f32(below)) / 255.0;
}
