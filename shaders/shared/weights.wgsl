// How a measurement's weight follows its depth.

const WEIGHT_LINEAR: u32 = 1u;
const WEIGHT_NOISE: u32 = 2u;

// All alike; the report's (1 - (z - near) / (far - near))², section 3.1.3; or the inverse of a Kinect's variance, relative to
// that at its best (Nguyen et al. 2012).
fn weight_by_depth(kind: u32, range: vec2<f32>, z: f32) -> f32 {
    let share = clamp(1.0 - (z - range.x) / (range.y - range.x), 0.0, 1.0);
    let beyond = max(z - 0.4, 0.0);
    let sigma = 1.0 + (0.0019 / 0.0012) * beyond * beyond;
    let linear = select(1.0, share * share, kind == WEIGHT_LINEAR);
    return select(linear, 1.0 / (sigma * sigma), kind == WEIGHT_NOISE);
}
