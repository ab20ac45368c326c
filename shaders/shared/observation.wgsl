// What a pixel's measurement says of a surfel.
import package::shared::camera::Camera;

// Radius in metres of the disc that a pixel sees at a depth, given the cosine between optical axis and normal: discs seen from the
// side are not drawn out beyond those at 75 degrees (Keller et al. 2013, section 4.1).
fn radius_of(radius_per_m: f32, z: f32, cosine: f32) -> f32 {
    return radius_per_m * z / max(abs(cosine), 0.26);
}

// How much a measurement counts by its distance from the image's centre, in half its diagonal: lenses are better there (the same).
fn sample_confidence(camera: Camera, pixel: vec2<u32>, sigma: f32) -> f32 {
    let middle = 0.5 * vec2<f32>(camera.size - vec2(1u));
    let share = length(vec2<f32>(pixel) - middle) / max(length(middle), 0.5);
    return exp(-share * share / (2.0 * sigma * sigma));
}
