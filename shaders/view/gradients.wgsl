// Intensity gradients along x and y, per pixel: Scharr's 3x3 kernels (Scharr 2000), with the border repeated. Zero where a
// pixel of the nine has no colour (-1): there is nothing to be had from an edge between something and nothing.

struct Params {
    size: vec2<u32>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> intensity: array<f32>;
@group(0) @binding(2) var<storage, read_write> gradients: array<vec2<f32>>;

fn at(pixel: vec2<i32>) -> f32 {
    let p = vec2<u32>(clamp(pixel, vec2(0), vec2<i32>(params.size) - vec2(1)));
    return intensity[p.y * params.size.x + p.x];
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if any(id.xy >= params.size) {
        return;
    }
    let p = vec2<i32>(id.xy);
    let a = at(p + vec2(-1, -1));
    let b = at(p + vec2(0, -1));
    let c = at(p + vec2(1, -1));
    let d = at(p + vec2(-1, 0));
    let e = at(p);
    let f = at(p + vec2(1, 0));
    let g = at(p + vec2(-1, 1));
    let h = at(p + vec2(0, 1));
    let i = at(p + vec2(1, 1));
    let dx = 3.0 * (c - a) + 10.0 * (f - d) + 3.0 * (i - g);
    let dy = 3.0 * (g - a) + 10.0 * (h - b) + 3.0 * (i - c);
    let least = min(min(min(a, b), min(c, d)), min(min(e, f), min(min(g, h), i)));
    gradients[id.y * params.size.x + id.x] = select(vec2(dx, dy) / 32.0, vec2(0.0), least < 0.0);
}
