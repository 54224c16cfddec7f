//! Judges a tracer's answers by the referee. Where rounding to f64 leaves two answers open, either is right, and the ray is
//! counted as too close to tell.

use glam::DVec3;

use super::dyadic::{self, Dyadic, Exact3, exact};
use super::referee::{ExactRay, Meeting, Referee};

/// What a tracer found: primitive and t, or nothing.
pub type Found = Option<(u32, f64)>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Right,
    /// The exact answer and the tracer's are both right within the bound of f64's rounding.
    TooClose,
    /// Nothing was found though the ray crosses a closed surface: it went through between triangles.
    Leak,
    /// Nothing was found though the ray meets the inside of a triangle.
    Miss,
    /// A surface in front of the one that was found was passed through.
    Skipped,
    /// What was found isn't there.
    FalseHit,
    /// A ray that starts on a surface met that surface again where it started.
    SelfHit,
}

#[derive(Clone, Copy, Debug)]
pub struct Judged {
    pub verdict: Verdict,
    /// Of a right answer the exact t, and the error of the tracer's.
    pub error: Option<TError>,
}

#[derive(Clone, Copy, Debug)]
pub struct TError {
    pub t: f64,
    pub error: f64,
    /// The error over 2^-53 (|origin|∞ + |vertex|∞) / |direction|∞.
    pub fine: f64,
}

/// How an answer compares with the exact one for a single exact ray.
#[derive(Clone, Copy, Debug)]
enum Stage {
    Right(Option<TError>),
    Open,
    /// Behind a surface that is surely met.
    Late,
    /// Behind a surface that is met, though perhaps not by every ray within the bound.
    PerhapsLate,
    False,
}

/// A triangle mesh with its referee.
#[derive(Debug)]
pub struct Court {
    pub referee: Referee,
    /// Whether the surface has no border: only then can it leak.
    pub closed: bool,
}

impl Court {
    /// Judges the answer to a ray from anywhere.
    pub fn judge(&self, ray: &ExactRay, found: Found) -> Judged {
        let aside = Aside { slack: 0.0, start: None };
        let verdict = match self.compare(ray, &aside, found) {
            Stage::Right(error) => return Judged { verdict: Verdict::Right, error },
            Stage::Open => Verdict::TooClose,
            Stage::False => Verdict::FalseHit,
            Stage::Late => self.late(found, true),
            Stage::PerhapsLate if self.late_all_around(ray, &aside, found) => self.late(found, false),
            Stage::PerhapsLate => Verdict::TooClose,
        };
        Judged { verdict, error: None }
    }

    /// Judges the answer to a ray that starts on a triangle, at the point of these barycentric weights of its second and third
    /// vertex.
    ///
    /// The ray's truth is that of a ray from the exact point; next to an edge or vertex that of rays from a little inside the triangle.
    pub fn judge_spawned(&self, start: u32, uv: [f64; 2], direction: DVec3, found: Found) -> Judged {
        let samples = self.samples(start, uv, direction);
        let aside = |slack: f64| Aside { slack, start: Some(start) };
        let stages: Vec<Stage> =
            samples.iter().map(|(ray, slack)| self.compare(ray, &aside(*slack), found)).collect();
        let right = stages.iter().filter(|stage| matches!(stage, Stage::Right(_))).count();
        if right == stages.len() {
            let error = match stages.as_slice() {
                [Stage::Right(error)] => *error,
                _ => None,
            };
            return Judged { verdict: Verdict::Right, error };
        }
        let all = |wanted: fn(&Stage) -> bool| stages.iter().all(wanted);
        let verdict = if right > 0 {
            Verdict::TooClose
        } else if self.is_self_hit(&samples, start, found) {
            Verdict::SelfHit
        } else if all(|stage| matches!(stage, Stage::False)) {
            Verdict::FalseHit
        } else if all(|stage| matches!(stage, Stage::Late)) {
            self.late(found, true)
        } else if all(|stage| matches!(stage, Stage::Late | Stage::PerhapsLate))
            && samples.iter().all(|(ray, slack)| self.late_all_around(ray, &aside(*slack), found))
        {
            self.late(found, false)
        } else {
            Verdict::TooClose
        };
        Judged { verdict, error: None }
    }

    fn late(&self, found: Found, surely: bool) -> Verdict {
        match found {
            Some(_) => Verdict::Skipped,
            None if surely => Verdict::Miss,
            None if self.closed => Verdict::Leak,
            None => Verdict::TooClose,
        }
    }

    fn compare(&self, ray: &ExactRay, aside: &Aside, found: Found) -> Stage {
        let mut near = self.referee.meetings(ray);
        near.retain(|meeting| !aside.excludes(&self.referee, meeting));
        let ahead = || near.iter().filter(|meeting| aside.counts(meeting));
        let first = ahead().min_by(|a, b| a.order(b));
        let late = |t: f64| {
            let before = |meeting: &&Meeting| {
                !meeting.optional() && t > meeting.t + meeting.uncertainty() + aside.slack * meeting.steepness
            };
            match ahead().filter(before).map(|meeting| meeting.surely).reduce(|a, b| a || b) {
                Some(true) => Stage::Late,
                Some(false) => Stage::PerhapsLate,
                None => Stage::Open,
            }
        };
        let Some((primitive, t)) = found else {
            return if first.is_none() { Stage::Right(None) } else { late(f64::INFINITY) };
        };
        let known = near.iter().find(|meeting| meeting.primitive == primitive).cloned();
        let own = match known {
            Some(own) => own,
            None if aside.start == Some(primitive) => return Stage::False,
            None => match self.referee.meeting(ray, primitive, aside.slack) {
                Some(own) => own,
                None => return Stage::False,
            },
        };
        if !own.allows(t, aside.slack) {
            return Stage::False;
        }
        match first {
            Some(first) if aside.counts(&own) && first.order(&own).is_eq() => {
                let error = (t - own.t).abs();
                let fine = error * ray.length() / self.referee.unit(ray);
                Stage::Right(Some(TError { t: own.t, error, fine }))
            }
            _ => late(t),
        }
    }

    /// Whether the answer is late for all rays around this one.
    fn late_all_around(&self, ray: &ExactRay, aside: &Aside, found: Found) -> bool {
        ray.ring(self.referee.aside(ray)).all(|moved| {
            let near = self.referee.meetings(&moved);
            let t = found.map_or(f64::INFINITY, |(_, t)| t);
            near.iter().any(|meeting| {
                aside.counts(meeting)
                    && !aside.excludes(&self.referee, meeting)
                    && !meeting.optional()
                    && t > meeting.t + meeting.uncertainty() + aside.slack * meeting.steepness
            })
        })
    }

    /// Whether the tracer met, at the start itself, a triangle that belongs to the start's surface and that none of the exact rays meets.
    fn is_self_hit(&self, samples: &[(ExactRay, f64)], start: u32, found: Found) -> bool {
        let Some((primitive, t)) = found else { return false };
        if primitive == start {
            return true;
        }
        if !self.belongs(primitive, start) {
            return false;
        }
        samples.iter().all(|(ray, slack)| {
            // The farthest from the start that rounding, and the sample's own distance from it, can bring the plane.
            let wide = 2.0 * slack + self.referee.aside(ray);
            self.referee.meeting(ray, primitive, wide).is_some_and(|own| {
                let reach = own.uncertainty() + wide * own.steepness;
                !own.beyond_origin() && (t <= reach || own.t.is_nan())
            })
        })
    }

    /// Whether two triangles share a vertex or a plane.
    fn belongs(&self, primitive: u32, start: u32) -> bool {
        let [own, other] = [start, primitive].map(|id| self.referee.triangles[id as usize]);
        own.iter().any(|v| other.contains(v)) || coplanar(&own, &other)
    }

    /// The exact rays whose answers a ray that starts here may give, each with its distance from the start.
    fn samples(&self, start: u32, [u, v]: [f64; 2], direction: DVec3) -> Vec<(ExactRay, f64)> {
        let vertices = self.referee.triangles[start as usize];
        let corners = vertices.map(|v| exact(v.map(f64::from)));
        let weights = {
            let [u, v] = [u, v].map(Dyadic::new);
            [Dyadic::new(1.0).minus(&u).minus(&v), u, v]
        };
        let at = |weights: &[Dyadic; 3]| -> Exact3 {
            let parts: [Exact3; 3] =
                std::array::from_fn(|k| std::array::from_fn(|axis| corners[k][axis].times(&weights[k])));
            dyadic::plus(&dyadic::plus(&parts[0], &parts[1]), &parts[2])
        };
        let point = ExactRay::new(at(&weights), direction);
        let bound = self.referee.aside(&point);
        let [a, b, c] = vertices.map(|v| DVec3::from(v.map(f64::from)));
        let sides = [(c - b).length(), (a - c).length(), (b - a).length()];
        let heights = sides.map(|side| (b - a).cross(c - a).length() / side);
        if (0..3).all(|k| weights[k].approximate() * heights[k] > 8.0 * bound) {
            return vec![(point, 0.0)];
        }
        // Weights of points inside, in eighths, all around.
        const INSIDE: [[f64; 3]; 6] = [
            [2.0, 3.0, 3.0],
            [3.0, 2.0, 3.0],
            [3.0, 3.0, 2.0],
            [6.0, 1.0, 1.0],
            [1.0, 6.0, 1.0],
            [1.0, 1.0, 6.0],
        ];
        let lowest = heights[0].min(heights[1]).min(heights[2]);
        let mut step = 0.25;
        while step > 1e-12 && step * lowest > 512.0 * bound {
            step *= 0.5;
        }
        let longest = sides[0].max(sides[1]).max(sides[2]);
        INSIDE
            .map(|inside| {
                let moved: [Dyadic; 3] = std::array::from_fn(|k| {
                    let inside = Dyadic::new(step * 0.125 * inside[k]);
                    weights[k].times(&Dyadic::new(1.0 - step)).plus(&inside)
                });
                (ExactRay::new(at(&moved), direction), step * longest)
            })
            .into()
    }
}

/// How an exact ray stands to the one that the tracer was given.
struct Aside {
    /// Distance between their origins.
    slack: f64,
    /// The triangle that the ray starts on.
    start: Option<u32>,
}

impl Aside {
    /// Whether the triangle is the start itself or coincides with it.
    fn excludes(&self, referee: &Referee, meeting: &Meeting) -> bool {
        self.start.is_some_and(|start| {
            let [own, other] = [start, meeting.primitive].map(|id| referee.triangles[id as usize]);
            start == meeting.primitive || other.iter().all(|v| own.contains(v))
        })
    }

    /// Whether the exact ray meets it; a surface at the very start of a ray is left, not met.
    fn counts(&self, meeting: &Meeting) -> bool {
        if self.start.is_some() { meeting.beyond_origin() } else { meeting.ahead() }
    }
}

/// Whether all six vertices lie in one plane, exactly.
fn coplanar(one: &[[f32; 3]; 3], other: &[[f32; 3]; 3]) -> bool {
    let [a, b, c] = one.map(|v| exact(v.map(f64::from)));
    let normal = dyadic::cross(&dyadic::minus(&b, &a), &dyadic::minus(&c, &a));
    other.iter().all(|v| dyadic::dot(&normal, &dyadic::minus(&exact(v.map(f64::from)), &a)).sign() == 0)
}
