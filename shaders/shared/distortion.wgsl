// A lens's distortion, as itm-core's: Brown and Conrady's polynomial (Brown 1966, 1971) over the rational model's
// denominator (Claus & Fitzgibbon 2005), with OpenCV's coefficients.
import package::shared::camera::Camera;

struct Distortion {
    k1: f32,
    k2: f32,
    p1: f32,
    p2: f32,
    k3: f32,
    k4: f32,
    k5: f32,
    k6: f32,
}

// Where the lens's image shows what a pinhole camera of the same intrinsics sees at a pixel.
fn distort_pixel(lens: Distortion, camera: Camera, pixel: vec2<f32>) -> vec2<f32> {
    let p = (pixel - camera.centre) / camera.focal;
    let xy = p.x * p.y;
    let r2 = dot(p, p);
    let factor = (1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))) / (1.0 + r2 * (lens.k4 + r2 * (lens.k5 + r2 * lens.k6)));
    let tangential = vec2(
        2.0 * lens.p1 * xy + lens.p2 * (r2 + 2.0 * p.x * p.x),
        lens.p1 * (r2 + 2.0 * p.y * p.y) + 2.0 * lens.p2 * xy,
    );
    // As an offset from the pixel: what the lens leaves in place keeps all its digits.
    return pixel + camera.focal * ((factor - 1.0) * p + tangential);
}

// Whether a position lies on one of the image's pixels, each reaching half a pixel around its centre.
fn on_image(camera: Camera, pixel: vec2<f32>) -> bool {
    return all(pixel >= vec2(-0.5)) && all(pixel < vec2<f32>(camera.size) - 0.5);
}
