// A pinhole camera. Pixel (0, 0) is the centre of the upper left pixel; fy may be negative.
struct Camera {
    focal: vec2<f32>,
    centre: vec2<f32>,
    size: vec2<u32>,
    // Nearest and farthest depth of interest, in metres.
    depth_range: vec2<f32>,
}

// The point (camera frame, metres) that a pixel sees at depth z.
fn unproject(camera: Camera, pixel: vec2<f32>, z: f32) -> vec3<f32> {
    return vec3((pixel - camera.centre) / camera.focal * z, z);
}

// The pixel that sees a point with z > 0 (camera frame).
fn project(camera: Camera, point: vec3<f32>) -> vec2<f32> {
    return camera.focal * point.xy / point.z + camera.centre;
}

// Whether all four pixels around a position, as bilinear interpolation reads them, lie inside the image.
fn inside(camera: Camera, pixel: vec2<f32>) -> bool {
    return all(pixel >= vec2(0.0)) && all(pixel <= vec2<f32>(camera.size - vec2(1u)));
}
