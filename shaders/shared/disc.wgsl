// Discs as a camera sees them.
import package::shared::camera::{Camera, unproject};

// Discs seen at less than this cosine from their side are not shown: they would be drawn out without end.
const LEAST_FACING: f32 = 0.1;

// Depth at which a pixel's ray meets a disc (camera frame), or 0 where it does not.
fn depth_on_disc(camera: Camera, pixel: vec2<f32>, centre: vec3<f32>, normal: vec3<f32>, radius: f32) -> f32 {
    let ray = unproject(camera, pixel, 1.0);
    let facing = dot(normal, ray);
    if facing > -LEAST_FACING * length(ray) {
        return 0.0;
    }
    let z = dot(normal, centre) / facing;
    let off = ray * z - centre;
    return select(0.0, z, dot(off, off) <= radius * radius);
}

// The pixels whose rays may meet a disc: the first, and the one behind the last, of those in the image, up to so many to each side of
// its centre.
fn pixels_of_disc(camera: Camera, centre: vec3<f32>, radius: f32, most: f32) -> vec4<i32> {
    let slope = centre.xy / centre.z;
    let middle = camera.focal * slope + camera.centre;
    // A point as far away as the radius is at least as deep as the sphere's front, and its slope differs from the centre's by no more
    // than this.
    let widest = radius * sqrt(1.0 + slope * slope) / max(centre.z - radius, 1e-6);
    let reach = min(abs(camera.focal) * widest, vec2(most));
    let size = vec2<f32>(camera.size);
    let low = clamp(ceil(middle - reach), vec2(0.0), size);
    let high = clamp(floor(middle + reach) + 1.0, vec2(0.0), size);
    return vec4<i32>(vec4(low, high));
}
