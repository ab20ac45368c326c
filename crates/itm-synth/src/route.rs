//! A smooth way along places, for paths that no short formula gives.

use glam::DVec3;

/// Where a camera is and where it looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place {
    /// In metres, in the world.
    pub(crate) position: DVec3,
    /// Radians to the right of +z.
    pub(crate) yaw: f64,
    /// Radians upwards.
    pub(crate) pitch: f64,
}

impl Place {
    /// A place `height` metres above the floor, with angles in degrees.
    pub(crate) fn new((x, z): (f64, f64), height: f64, yaw_degrees: f64, pitch_degrees: f64) -> Self {
        let position = DVec3::new(x, -height, z);
        Self { position, yaw: yaw_degrees.to_radians(), pitch: pitch_degrees.to_radians() }
    }

    fn plus_scaled(self, other: Self, by: f64) -> Self {
        Self {
            position: self.position + by * other.position,
            yaw: self.yaw + by * other.yaw,
            pitch: self.pitch + by * other.pitch,
        }
    }

    fn towards(self, other: Self, share: f64) -> Self {
        self.plus_scaled(self, -share).plus_scaled(other, share)
    }
}

/// How fast a [`Route`] is gone at most.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    pub(crate) m_per_s: f64,
    pub(crate) degrees_per_s: f64,
}

/// A way from place to place, from rest at the first to rest at the last, cutting corners a little.
///
/// Between places the camera would go straight and evenly, as fast as the pace allows. Places on that way at equal times
/// are the control points of a uniform B-spline of degree 5: four derivatives are continuous, and no speed is higher than
/// between two control points.
#[derive(Clone, Debug)]
pub(crate) struct Route {
    /// From two steps before the start to three after the end.
    controls: Vec<Place>,
    steps: usize,
}

/// Degree of the spline.
const DEGREE: usize = 5;
/// Seconds from control point to control point.
const STEP_S: f64 = 0.5;
/// Equal control points that make the spline rest at an end, and stand on it exactly.
const RESTING_STEPS: f64 = 3.0;

impl Route {
    /// A route along at least one place.
    pub(crate) fn new(places: &[Place], pace: Pace) -> Self {
        let mut times_s = vec![RESTING_STEPS * STEP_S];
        for pair in places.windows(2) {
            let way_s = pair[1].position.distance(pair[0].position) / pace.m_per_s;
            let turn_s = (pair[1].yaw - pair[0].yaw).abs().to_degrees() / pace.degrees_per_s;
            times_s.push(times_s[times_s.len() - 1] + way_s.max(turn_s));
        }
        let steps = (times_s[times_s.len() - 1] / STEP_S + RESTING_STEPS).ceil() as usize;
        let controls = (0..=steps + DEGREE)
            .map(|i| {
                let time_s = (i as f64 - 2.0) * STEP_S;
                let next = times_s.partition_point(|t| *t <= time_s);
                if next == 0 || next == places.len() {
                    return places[next.saturating_sub(1)];
                }
                let [from_s, to_s] = [times_s[next - 1], times_s[next]];
                places[next - 1].towards(places[next], (time_s - from_s) / (to_s - from_s))
            })
            .collect();
        Self { controls, steps }
    }

    /// Seconds that the route takes at its pace.
    #[cfg(test)]
    pub(crate) fn duration_s(&self) -> f64 {
        self.steps as f64 * STEP_S
    }

    /// Where the camera is after a share, 0 to 1, of the route's time.
    pub(crate) fn at(&self, share: f64) -> Place {
        let at = share.clamp(0.0, 1.0) * self.steps as f64;
        let span = (at as usize).min(self.steps - 1);
        let mut place = Place { position: DVec3::ZERO, yaw: 0.0, pitch: 0.0 };
        for (control, weight) in self.controls[span..].iter().zip(basis(at - span as f64)) {
            place = place.plus_scaled(*control, weight);
        }
        place
    }
}

/// Weights of the control points around a share of a span, by the recursion of Cox and de Boor (de Boor 1972, *On
/// Calculating with B-splines*).
fn basis(u: f64) -> [f64; DEGREE + 1] {
    let mut weights = [0.0; DEGREE + 1];
    weights[0] = 1.0;
    for degree in 1..=DEGREE {
        let d = degree as f64;
        for i in (0..=degree).rev() {
            let before = if i == 0 { 0.0 } else { weights[i - 1] };
            weights[i] = ((u + d - i as f64) * before + (i as f64 + 1.0 - u) * weights[i]) / d;
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;

    const PACE: Pace = Pace { m_per_s: 0.5, degrees_per_s: 30.0 };

    fn corner() -> Route {
        let place = |x, z, yaw| Place::new((x, z), 1.5, yaw, -10.0);
        Route::new(&[place(0.0, 0.0, 0.0), place(3.0, 0.0, 0.0), place(3.0, 2.0, 90.0)], PACE)
    }

    #[test]
    fn weights_add_up_and_are_smooth() {
        for i in 0..=10 {
            let weights = basis(0.1 * f64::from(i));
            assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-14 && weights.iter().all(|w| *w >= 0.0));
        }
        let expected = [1.0, 26.0, 66.0, 26.0, 1.0, 0.0].map(|w| w / 120.0);
        assert!(basis(0.0).iter().zip(expected).all(|(w, e)| (w - e).abs() < 1e-15));
        assert!(basis(1.0).iter().skip(1).zip(expected).all(|(w, e)| (w - e).abs() < 1e-15));
    }

    #[test]
    fn a_route_rests_at_its_ends_and_keeps_its_pace() {
        let route = corner();
        // 6 s straight on, 4 s around the corner, and six steps of rest.
        assert_eq!(route.duration_s(), 13.0);
        assert_eq!(route.at(0.0).position, DVec3::new(0.0, -1.5, 0.0));
        let end = route.at(1.0);
        assert!(end.position.distance(DVec3::new(3.0, -1.5, 2.0)) < 1e-12);
        assert!((end.yaw.to_degrees() - 90.0).abs() < 1e-9 && (end.pitch.to_degrees() + 10.0).abs() < 1e-9);
        let step_s = route.duration_s() / 1000.0;
        let places: Vec<_> = (0..=1000).map(|i| route.at(f64::from(i) / 1000.0)).collect();
        let speeds: Vec<_> = places.windows(2).map(|p| p[1].position.distance(p[0].position) / step_s).collect();
        let turning = places.windows(2).map(|p| (p[1].yaw - p[0].yaw).to_degrees() / step_s);
        assert!(speeds.iter().all(|v| *v < 0.5 + 1e-9) && turning.clone().all(|w| w < 30.0 + 1e-9));
        assert!(speeds[0] < 1e-6 && speeds[999] < 1e-6 && speeds[400] > 0.499, "{speeds:?}");
        assert!(speeds.windows(2).all(|v| (v[1] - v[0]).abs() < 0.02), "{speeds:?}");
    }

    #[test]
    fn a_route_of_one_place_stays_there() {
        let place = Place::new((1.0, 2.0), 1.0, 30.0, 0.0);
        let at = Route::new(&[place], PACE).at(0.4);
        assert!(at.position.distance(place.position) < 1e-12 && (at.yaw - place.yaw).abs() < 1e-12);
    }
}
