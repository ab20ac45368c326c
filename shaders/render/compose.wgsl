// Puts a picture of a raycast image onto a canvas, where it is nearer than what the canvas shows already.

struct Params {
    size: vec2<u32>,
    // Words from a row of the canvas to the next.
    pitch: u32,
    unused: u32,
    // The camera's centre, and the unit vector along its optical axis, in the frame of the points.
    camera: vec4<f32>,
    forward: vec4<f32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> points: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> picture: array<u32>;
// Depth along the optical axis of what the canvas shows, in metres, in rows like the canvas's; 0 where it shows nothing.
@group(0) @binding(3) var<storage, read_write> depths: array<f32>;
@group(0) @binding(4) var<storage, read_write> canvas: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixels = params.size.x * params.size.y;
    for (var i = id.x; i < pixels; i += groups.x * 64u) {
        let colour = picture[i];
        if (colour >> 24u) == 0u {
            continue;
        }
        let depth = dot(points[i].xyz - params.camera.xyz, params.forward.xyz);
        let at = i / params.size.x * params.pitch + i % params.size.x;
        if depths[at] == 0.0 || depth < depths[at] {
            depths[at] = depth;
            canvas[at] = colour;
        }
    }
}
