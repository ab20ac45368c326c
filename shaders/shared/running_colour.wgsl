// Means of colours that are kept as bytes, with the number of colours in the highest byte.

// The word after one more colour (0 to 255). A mean of bytes would stop following once its steps round to zero: moving by at least
// one towards the observation turns it into a running median there. A little over a half: halves are rounded up, so that
// downwards they stand still.
fn with_colour(word: u32, observed: vec3<f32>, most: u32) -> u32 {
    let weight = word >> 24u;
    let old = unpack4x8unorm(word).rgb * 255.0;
    let change = (observed - old) / f32(weight + 1u);
    let least = select(vec3(0.0), sign(observed - old), abs(observed - old) >= vec3(1.0));
    let moved = select(old + change, old + least, abs(change) < vec3(0.51));
    return pack4x8unorm(vec4(moved / 255.0, 0.0)) | (min(weight + 1u, min(most, 255u)) << 24u);
}
