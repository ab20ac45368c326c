// How pictures are coloured.

const GREY: u32 = 0u;
const NORMALS: u32 = 1u;
const DEPTH: u32 = 2u;
const CONFIDENCE: u32 = 3u;
const PHONG: u32 = 4u;
const COLOUR: u32 = 5u;
const SHININESS: f32 = 20.0;

// Grey by the cosine of the angle between a surface's normal and the light, which is at the camera (Lambert). PHONG has a
// highlight as well.
fn lit(kind: u32, cosine: f32) -> vec3<f32> {
    let facing = min(abs(cosine), 1.0);
    if kind == PHONG {
        // Light and eye are one, so that the reflected ray's angle to the eye is twice the light's to the normal.
        let mirrored = max(2.0 * facing * facing - 1.0, 0.0);
        return vec3(0.1 + 0.6 * facing + 0.3 * pow(mirrored, SHININESS));
    }
    return vec3(0.15 + 0.8 * facing);
}

// A value on the scale of colours between two ends.
fn on_scale(value: f32, range: vec2<f32>) -> vec3<f32> {
    return scale_colour(clamp((value - range.x) / (range.y - range.x), 0.0, 1.0));
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
