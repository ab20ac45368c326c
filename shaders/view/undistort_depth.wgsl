// Depth of a camera with a lens to that of a pinhole camera with the same intrinsics: each pixel takes the nearest of the
// lens's image. Interpolating would make up surfaces between foreground and background. Depth is along the optical axis,
// which the lens leaves as it is. Pixels that the lens's image does not show become 0.
import package::shared::camera::Camera;
import package::shared::distortion::{Distortion, distort_pixel, on_image};

struct Params {
    camera: Camera,
    lens: Distortion,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> distorted: array<f32>;
@group(0) @binding(2) var<storage, read_write> depth: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = params.camera.size;
    if any(id.xy >= size) {
        return;
    }
    let source = distort_pixel(params.lens, params.camera, vec2<f32>(id.xy));
    var z = 0.0;
    if on_image(params.camera, source) {
        let nearest = min(vec2<u32>(source + 0.5), size - vec2(1u));
        z = distorted[nearest.y * size.x + nearest.x];
    }
    depth[id.y * size.x + id.x] = z;
}
