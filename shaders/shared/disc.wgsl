// Discs as a camera sees them.
import package::shared::camera::{Camera, unproject};

// Discs seen at less than this cosine from their side are not shown: they would be drawn out without end.
const LEAST_FACING: f32 = 0.1;

// A disc as the camera sees it, camera frame, metres. The radius is 0 where there is none.
struct Disc {
    centre: vec3<f32>,
    radius: f32,
    normal: vec3<f32>,
    known: f32,
}

// How well a disc is known: its rank plus one, and for those that are preferred this much more, so that they come first.
const OTHERS: f32 = 256.0;

fn known_of(rank: u32, is_preferred: bool) -> f32 {
    return f32(rank + 1u) + select(0.0, OTHERS, is_preferred);
}

fn rank_of_known(known: f32) -> u32 {
    return u32(known - 1.0) & 255u;
}

// Depth at which a pixel's ray meets a disc (camera frame), or 0 where it does not.
fn depth_on_disc(camera: Camera, pixel: vec2<f32>, centre: vec3<f32>, normal: vec3<f32>, radius: f32) -> f32 {
    let ray = unproject(camera, pixel, 1.0);
    let facing = dot(normal, ray);
    let z = dot(normal, centre) / facing;
    let off = ray * z - centre;
    let faces = facing < 0.0 && facing * facing >= LEAST_FACING * LEAST_FACING * dot(ray, ray);
    return select(0.0, z, faces && dot(off, off) <= radius * radius);
}

// The pixels whose rays may meet a disc: the first, and the one behind the last, of those in the image, up to so many to each side of
// its centre. None where it is turned away.
fn pixels_of_disc(camera: Camera, centre: vec3<f32>, normal: vec3<f32>, radius: f32, most: f32) -> vec4<i32> {
    if dot(normal, centre) >= 0.0 {
        return vec4(0);
    }
    // A disc is seen as an ellipse, whose tangents' dual conic is r² (1 - n nᵀ) - c cᵀ (Hartley and Zisserman 2004, section 8.3 for
    // its projection). Of the vertical tangents x/z = slope + t the conic asks that a t² - 2 b t + d = 0, and of the horizontal ones alike.
    let slope = centre.xy / centre.z;
    let r2 = radius * radius;
    let across = normal.xy - slope * normal.z;
    let a = r2 * (1.0 - normal.z * normal.z) - centre.z * centre.z;
    let b = -r2 * (slope + across * normal.z);
    let d = r2 * (1.0 + slope * slope - across * across);
    // Where the disc reaches behind the camera it may be seen anywhere.
    let root = sqrt(max(b * b - a * d, vec2(0.0)));
    let is_before = a < 0.0;
    // A little more, for roundings.
    let low_reach = select(vec2(most), abs(camera.focal) * (root + b * sign(camera.focal)) / -a + 0.01, is_before);
    let high_reach = select(vec2(most), abs(camera.focal) * (root - b * sign(camera.focal)) / -a + 0.01, is_before);
    let middle = camera.focal * slope + camera.centre;
    let size = vec2<f32>(camera.size);
    let low = clamp(ceil(middle - min(low_reach, vec2(most))), vec2(0.0), size);
    let high = clamp(floor(middle + min(high_reach, vec2(most))) + 1.0, vec2(0.0), size);
    return vec4<i32>(vec4(low, high));
}
