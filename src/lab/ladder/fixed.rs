//! Rays and spheres in integers: the arithmetic of the 1994 real-time ray tracer on Pixel-Planes 5, and of wider words.
//!
//! Numbers of n bits: coordinates count 2^-(n-1), directions 2^-(n-2). What is stored between steps has at most 2n bits and a sign; a
//! multiplier may form a longer product if the result is shifted back at once. t, the distance along the ray, has `fraction` bits
//! below those of a coordinate, and with it so have the term b of the quadratic and the square root, which it is the difference of. Results are
//! rounded to the nearest number. That tracer's sizes are those of its description, 12 and 24 bits and a t with 0 or 6
//! more; the order of the steps is ours.

use std::fmt::Debug;
use std::ops::{Add, Div, Mul, Neg, Shl, Shr, Sub};

use glam::DVec3;

use super::sphere::{Arithmetic, Bounce};

/// An integer that is long enough to form the products.
pub trait Word:
    Copy
    + Debug
    + Ord
    + Send
    + Sync
    + From<i64>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Shl<u32, Output = Self>
    + Shr<u32, Output = Self>
{
    /// The largest integer not above the square root of one not below 0.
    fn root(self) -> Self;
    fn real(self) -> f64;
}

impl Word for i64 {
    #[inline]
    fn root(self) -> Self {
        self.isqrt()
    }

    fn real(self) -> f64 {
        self as f64
    }
}

impl Word for i128 {
    #[inline]
    fn root(self) -> Self {
        self.isqrt()
    }

    fn real(self) -> f64 {
        self as f64
    }
}

/// Fixed point with numbers of `bits` bits, computed in `W`: i64 up to 16 bits, i128 up to 32.
#[derive(Clone, Copy, Debug)]
pub struct Fixed<W> {
    bits: u32,
    /// Of t, below the bits of a coordinate.
    fraction: u32,
    word: std::marker::PhantomData<W>,
}

/// A ray in integers.
#[derive(Clone, Copy, Debug)]
pub struct FixedRay<W> {
    origin: [W; 3],
    direction: [W; 3],
}

/// A sphere in integers: its centre and radius.
#[derive(Clone, Copy, Debug)]
pub struct FixedBall<W> {
    center: [W; 3],
    radius: W,
}

impl<W: Word> Fixed<W> {
    pub fn new(bits: u32, fraction: u32) -> Self {
        Fixed { bits, fraction, word: std::marker::PhantomData }
    }

    fn coordinate(&self, x: f64) -> W {
        W::from((x * (1i64 << (self.bits - 1)) as f64).round() as i64)
    }

    /// Bits of a direction's fraction.
    fn unit(&self) -> u32 {
        self.bits - 2
    }

    /// A number that is stored between steps: it must fit into 2n bits and a sign.
    #[inline]
    fn stored(&self, x: W) -> W {
        debug_assert!((if x < W::from(0) { -x } else { x }) >> (2 * self.bits) == W::from(0), "{x:?}");
        x
    }
}

/// x / 2^bits.
#[inline]
fn shift<W: Word>(x: W, bits: u32) -> W {
    if bits == 0 { x } else { (x + (W::from(1) << (bits - 1))) >> bits }
}

/// x / y for y > 0.
#[inline]
fn divide<W: Word>(x: W, y: W) -> W {
    let half = y >> 1;
    if x < W::from(0) { (x - half) / y } else { (x + half) / y }
}

#[inline]
fn dot<W: Word>(a: [W; 3], b: [W; 3]) -> W {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl<W: Word> Arithmetic for Fixed<W> {
    type Ray = FixedRay<W>;
    type Ball = FixedBall<W>;
    type T = W;

    fn ball(&self, center: DVec3, radius: f64) -> FixedBall<W> {
        FixedBall { center: center.to_array().map(|c| self.coordinate(c)), radius: self.coordinate(radius) }
    }

    fn ray(&self, origin: DVec3, direction: DVec3) -> FixedRay<W> {
        let unit = (1i64 << self.unit()) as f64;
        FixedRay {
            origin: origin.to_array().map(|c| self.coordinate(c)),
            direction: direction.to_array().map(|c| W::from((c * unit).round() as i64)),
        }
    }

    #[inline]
    fn meet(&self, ray: &FixedRay<W>, ball: &FixedBall<W>) -> Option<W> {
        let (unit, fraction) = (self.unit(), self.fraction);
        let f: [W; 3] = std::array::from_fn(|axis| ray.origin[axis] - ball.center[axis]);
        // A reflected direction has a length of about 1 only, so the quadratic's a stays in.
        let a = self.stored(dot(ray.direction, ray.direction));
        let along = self.stored(-dot(f, ray.direction));
        let b = self.stored(divide(along << (unit + fraction), a));
        // r² less the squared distance of the line from the centre.
        let discriminant =
            self.stored(ball.radius * ball.radius - dot(f, f) + shift(along * b, unit + fraction));
        if discriminant < W::from(0) {
            return None;
        }
        let square = self.stored(divide(discriminant << (2 * unit), a));
        // Rounded: half of the root of four times the square, and a half.
        let root = shift((square << (2 * fraction + 2)).root(), 1);
        let (near, far) = (b - root, b + root);
        let zero = W::from(0);
        if near > zero { Some(near) } else { (far > zero).then_some(far) }
    }

    fn bounce(&self, ray: &FixedRay<W>, ball: &FixedBall<W>, t: W) -> Bounce<FixedRay<W>> {
        let (unit, fraction) = (self.unit(), self.fraction);
        let d = ray.direction;
        // The point has t's fraction; only the reflected ray's origin is a coordinate again.
        let point: [W; 3] =
            std::array::from_fn(|axis| (ray.origin[axis] << fraction) + shift(t * d[axis], unit));
        let normal: [W; 3] = std::array::from_fn(|axis| {
            let out = point[axis] - (ball.center[axis] << fraction);
            divide(out << unit, ball.radius << fraction)
        });
        let along = self.stored(dot(d, normal));
        let reflected = std::array::from_fn(|axis| d[axis] - shift(along * normal[axis], 2 * unit - 1));
        let origin = point.map(|c| shift(c, fraction));
        Bounce {
            normal: DVec3::from(normal.map(W::real)).normalize_or(DVec3::Z),
            reflected: FixedRay { origin, direction: reflected },
        }
    }

    fn distance(&self, ray: &FixedRay<W>, t: W) -> f64 {
        let length = DVec3::from(ray.direction.map(W::real)).length() / (1i64 << self.unit()) as f64;
        t.real() * length / (1i64 << (self.bits - 1 + self.fraction)) as f64
    }

    fn direction(&self, ray: &FixedRay<W>) -> DVec3 {
        DVec3::from(ray.direction.map(W::real)).normalize_or(DVec3::Z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_on_every_width_gives_the_exact_t() {
        fn check<W: Word>(fixed: Fixed<W>) {
            let ball = fixed.ball(DVec3::new(0.0, 0.0, 0.5), 0.25);
            let ray = fixed.ray(DVec3::new(0.0, 0.0, -0.5), DVec3::Z);
            let t = fixed.meet(&ray, &ball).expect("straight on");
            assert_eq!(fixed.distance(&ray, t), 0.75, "{fixed:?}");
            let bounce = fixed.bounce(&ray, &ball, t);
            assert_eq!(bounce.normal, DVec3::NEG_Z);
            assert_eq!(fixed.direction(&bounce.reflected), DVec3::NEG_Z);
            assert!(fixed.meet(&fixed.ray(DVec3::new(0.3, 0.0, -0.5), DVec3::Z), &ball).is_none());
            assert!(fixed.meet(&fixed.ray(DVec3::new(0.0, 0.0, -0.5), DVec3::NEG_Z), &ball).is_none());
        }
        check(Fixed::<i64>::new(12, 0));
        check(Fixed::<i64>::new(12, 6));
        check(Fixed::<i64>::new(16, 8));
        check(Fixed::<i128>::new(24, 12));
        check(Fixed::<i128>::new(32, 16));
    }

    #[test]
    fn rounding_is_to_the_nearest() {
        let halves: Vec<i64> = [-3, -2, -1, 0, 1, 2, 3].map(|x| shift(x, 1)).to_vec();
        assert_eq!(halves, [-1, -1, 0, 0, 1, 1, 2]);
        let thirds: Vec<i64> = [-5, -4, -1, 1, 4, 5].map(|x| divide(x, 3)).to_vec();
        assert_eq!(thirds, [-2, -1, 0, 0, 1, 2]);
    }
}
