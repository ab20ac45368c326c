//! Solids as signed distance functions.

use glam::{Vec2, Vec3};

/// A solid around the origin of its own coordinates (metres, y down), described by its signed distance: positive
/// outside, negative inside, exact on both sides (Hart 1996, *Sphere Tracing*, appendix A, has the idea and most of
/// the formulas).
///
/// Round solids have y as their axis, so that they stand upright in a world whose y points down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Everything below the plane y = 0 (that is, where y > 0): an endless floor.
    Plane,
    /// A ball.
    Sphere {
        /// Radius in metres.
        radius: f32,
    },
    /// A box, its edges rounded or not.
    Box {
        /// Half of its sides in metres, rounding included.
        half: Vec3,
        /// Radius of its edges in metres; at most the smallest half side.
        rounding: f32,
    },
    /// An upright cylinder, its edges rounded or not.
    Cylinder {
        /// Radius in metres, rounding included.
        radius: f32,
        /// Half of its height in metres, rounding included.
        half_height: f32,
        /// Radius of its edges in metres; at most the smaller of the other two.
        rounding: f32,
    },
    /// An upright cylinder ending in half balls.
    Capsule {
        /// Radius in metres.
        radius: f32,
        /// Half of the distance between the centres of the two half balls, in metres.
        half_height: f32,
    },
    /// A ring lying flat.
    Torus {
        /// Radius of the ring's centre line in metres.
        major: f32,
        /// Radius of the ring's tube in metres.
        minor: f32,
    },
    /// An upright cone with its tip cut off, as of flower pots and lampshades.
    Cone {
        /// Radius at the top (the smaller y) in metres.
        top: f32,
        /// Radius at the bottom in metres.
        bottom: f32,
        /// Half of its height in metres.
        half_height: f32,
    },
}

impl Shape {
    /// A box with sharp edges from its full sides in metres.
    pub const fn cuboid(x: f32, y: f32, z: f32) -> Self {
        Self::Box { half: Vec3::new(0.5 * x, 0.5 * y, 0.5 * z), rounding: 0.0 }
    }

    /// A box with rounded edges from its full sides and the edges' radius in metres.
    pub const fn rounded(x: f32, y: f32, z: f32, rounding: f32) -> Self {
        Self::Box { half: Vec3::new(0.5 * x, 0.5 * y, 0.5 * z), rounding }
    }

    /// An upright cylinder with sharp edges from its radius and full height in metres.
    pub const fn cylinder(radius: f32, height: f32) -> Self {
        Self::Cylinder { radius, half_height: 0.5 * height, rounding: 0.0 }
    }

    /// Signed distance in metres from a point in the shape's own coordinates to its surface.
    pub fn distance(&self, p: Vec3) -> f32 {
        match *self {
            Self::Plane => -p.y,
            Self::Sphere { radius } => p.length() - radius,
            Self::Box { half, rounding } => {
                let q = p.abs() - (half - rounding);
                q.max(Vec3::ZERO).length() + q.max_element().min(0.0) - rounding
            }
            Self::Cylinder { radius, half_height, rounding } => {
                let q = meridian(p).abs() - (Vec2::new(radius, half_height) - rounding);
                q.max(Vec2::ZERO).length() + q.max_element().min(0.0) - rounding
            }
            Self::Capsule { radius, half_height } => {
                (p - Vec3::Y * p.y.clamp(-half_height, half_height)).length() - radius
            }
            Self::Torus { major, minor } => (meridian(p) - Vec2::new(major, 0.0)).length() - minor,
            Self::Cone { top, bottom, half_height } => cone(meridian(p), top, bottom, half_height).0,
        }
    }

    /// Direction in which the distance grows fastest, of unit length: on the surface, its outward normal.
    pub fn gradient(&self, p: Vec3) -> Vec3 {
        match *self {
            Self::Plane => -Vec3::Y,
            Self::Sphere { .. } => p.normalize_or(-Vec3::Y),
            Self::Box { half, rounding } => {
                let q = p.abs() - (half - rounding);
                let outward = if q.max_element() > 0.0 {
                    q.max(Vec3::ZERO).normalize()
                } else if q.x >= q.y && q.x >= q.z {
                    Vec3::X
                } else if q.y >= q.z {
                    Vec3::Y
                } else {
                    Vec3::Z
                };
                outward * Vec3::ONE.copysign(p)
            }
            Self::Cylinder { radius, half_height, rounding } => {
                let m = meridian(p);
                let q = m.abs() - (Vec2::new(radius, half_height) - rounding);
                let outward = if q.max_element() > 0.0 {
                    q.max(Vec2::ZERO).normalize()
                } else if q.x >= q.y {
                    Vec2::X
                } else {
                    Vec2::Y
                };
                revolve(p, outward * Vec2::ONE.copysign(m))
            }
            Self::Capsule { half_height, .. } => {
                (p - Vec3::Y * p.y.clamp(-half_height, half_height)).normalize_or(Vec3::X)
            }
            Self::Torus { major, .. } => revolve(p, (meridian(p) - Vec2::new(major, 0.0)).normalize_or(Vec2::X)),
            Self::Cone { top, bottom, half_height } => revolve(p, cone(meridian(p), top, bottom, half_height).1),
        }
    }

    /// Coordinates on the surface in metres for patterns: along the two axes of the side of a box that a point lies
    /// on, or around and along a round solid.
    pub(crate) fn surface_coordinates(&self, p: Vec3, normal: Vec3) -> Vec2 {
        let n = normal.abs();
        let flat = if n.y >= n.x && n.y >= n.z {
            Vec2::new(p.x, p.z)
        } else if n.x >= n.z {
            Vec2::new(p.z, p.y)
        } else {
            Vec2::new(p.x, p.y)
        };
        match *self {
            Self::Plane | Self::Box { .. } => flat,
            Self::Cylinder { .. } | Self::Cone { .. } if n.y > 0.9 => flat,
            Self::Sphere { radius } => Vec2::new(p.x.atan2(p.z), (p.y / radius).clamp(-1.0, 1.0).asin()) * radius,
            Self::Cylinder { radius, .. } | Self::Capsule { radius, .. } => Vec2::new(p.x.atan2(p.z) * radius, p.y),
            Self::Cone { top, bottom, .. } => Vec2::new(p.x.atan2(p.z) * top.max(bottom), p.y),
            Self::Torus { major, minor } => {
                let m = meridian(p) - Vec2::new(major, 0.0);
                Vec2::new(p.x.atan2(p.z) * major, m.y.atan2(m.x) * minor)
            }
        }
    }
}

/// Distance from the y axis, and y: where a point lies in the half plane that a round solid's outline turns in.
fn meridian(p: Vec3) -> Vec2 {
    Vec2::new((p.x * p.x + p.z * p.z).sqrt(), p.y)
}

/// A direction of the half plane through `p`, in space.
fn revolve(p: Vec3, direction: Vec2) -> Vec3 {
    let away = Vec2::new(p.x, p.z).normalize_or(Vec2::X);
    Vec3::new(away.x * direction.x, direction.y, away.y * direction.x)
}

/// Signed distance to the outline of a cut cone, and its gradient.
fn cone(m: Vec2, top: f32, bottom: f32, half_height: f32) -> (f32, Vec2) {
    let (a, b) = (Vec2::new(top, -half_height), Vec2::new(bottom, half_height));
    let to_cap = |end: Vec2| Vec2::new(m.x - m.x.min(end.x), m.y - end.y);
    let along = b - a;
    let to_side = m - (a + along * ((m - a).dot(along) / along.length_squared()).clamp(0.0, 1.0));
    let side_normal = Vec2::new(along.y, -along.x).normalize();
    let inside = m.y.abs() < half_height && (m - a).dot(side_normal) < 0.0;
    let candidates = [(to_cap(a), -Vec2::Y), (to_cap(b), Vec2::Y), (to_side, side_normal)];
    let mut nearest = candidates[0];
    for candidate in &candidates[1..] {
        if candidate.0.length_squared() < nearest.0.length_squared() {
            nearest = *candidate;
        }
    }
    let (offset, normal) = nearest;
    let sign = if inside { -1.0 } else { 1.0 };
    // On the surface itself the offset has no direction left; the side's own normal has.
    let gradient = if offset.length() < 1e-5 { normal } else { (sign * offset).normalize() };
    (sign * offset.length(), gradient)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SHAPES: [Shape; 9] = [
        Shape::Plane,
        Shape::Sphere { radius: 0.7 },
        Shape::cuboid(1.0, 0.4, 1.6),
        Shape::rounded(1.0, 0.4, 1.6, 0.1),
        Shape::cylinder(0.5, 1.2),
        Shape::Cylinder { radius: 0.5, half_height: 0.3, rounding: 0.1 },
        Shape::Capsule { radius: 0.2, half_height: 0.6 },
        Shape::Torus { major: 0.8, minor: 0.2 },
        Shape::Cone { top: 0.3, bottom: 0.8, half_height: 0.5 },
    ];

    fn point() -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(-2.0f32..2.0).prop_map(Vec3::from)
    }

    proptest! {
        /// A step along the gradient by the distance ends on the surface, from outside and from within: that is what
        /// makes a distance exact rather than a bound.
        #[test]
        fn walking_the_distance_ends_on_the_surface(p in point(), i in 0..SHAPES.len()) {
            let shape = SHAPES[i];
            let d = shape.distance(p);
            let foot = p - d * shape.gradient(p);
            prop_assert!(shape.distance(foot).abs() < 2e-5, "{shape:?} at {p}: {d}, then {}", shape.distance(foot));
        }

        #[test]
        fn distances_change_by_no_more_than_the_way_gone(p in point(), q in point(), i in 0..SHAPES.len()) {
            let change = (SHAPES[i].distance(p) - SHAPES[i].distance(q)).abs();
            prop_assert!(change <= p.distance(q) + 1e-5);
        }
    }

    #[test]
    fn distances_agree_with_what_can_be_worked_out_by_hand() {
        let near = |found: f32, expected: f32| assert!((found - expected).abs() < 1e-6, "{found} is not {expected}");
        near(Shape::Plane.distance(Vec3::new(3.0, -1.5, 0.0)), 1.5);
        near(Shape::cuboid(2.0, 2.0, 2.0).distance(Vec3::new(4.0, 5.0, 0.0)), 5.0);
        near(Shape::cuboid(2.0, 2.0, 2.0).distance(Vec3::new(0.75, 0.0, 0.0)), -0.25);
        near(Shape::rounded(2.0, 2.0, 2.0, 1.0).distance(Vec3::new(0.0, 3.0, 4.0)), 4.0);
        near(Shape::cylinder(1.0, 2.0).distance(Vec3::new(0.0, 5.0, 4.0)), 5.0);
        near(Shape::Capsule { radius: 0.5, half_height: 1.0 }.distance(Vec3::new(3.0, -5.0, 0.0)), 4.5);
        near(Shape::Torus { major: 3.0, minor: 1.0 }.distance(Vec3::ZERO), 2.0);
        near(Shape::Cone { top: 1.0, bottom: 1.0, half_height: 1.0 }.distance(Vec3::new(4.0, 5.0, 0.0)), 5.0);
        near(Shape::Cone { top: 0.5, bottom: 1.0, half_height: 2.0 }.distance(Vec3::new(0.0, -1.9, 0.0)), -0.1);
    }
}
