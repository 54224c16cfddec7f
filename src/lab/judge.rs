//! Judges a tracer's answers by the referee. Where rounding to f64 leaves two answers open, either is right, and the ray is
//! counted as too close to tell.

use glam::DVec3;

use super::footing::Footing;
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
    /// Edges where the surface ends: next to them nothing can leak.
    pub border: Vec<[[f32; 3]; 2]>,
}

impl Court {
    /// Judges the answer to a ray from anywhere.
    pub fn judge(&self, ray: &ExactRay, found: Found) -> Judged {
        let aside = Aside { slack: 0.0, start: None };
        let verdict = match self.compare(ray, &aside, found) {
            Stage::Right(error) => return Judged { verdict: Verdict::Right, error },
            Stage::Open => Verdict::TooClose,
            Stage::False => Verdict::FalseHit,
            Stage::Late => self.late(ray, found, true),
            Stage::PerhapsLate if self.late_all_around(ray, &aside, found) => self.late(ray, found, false),
            Stage::PerhapsLate => Verdict::TooClose,
        };
        Judged { verdict, error: None }
    }

    /// Judges the answer to a ray that starts on a triangle, at the point of these barycentric weights of its second and third
    /// vertex.
    ///
    /// The ray's truth is that of a ray from the exact point; next to an edge or vertex that of rays from a little inside the triangle.
    pub fn judge_spawned(&self, start: u32, uv: [f64; 2], direction: DVec3, found: Found) -> Judged {
        let footing = Footing::new(&self.referee, start, uv, direction);
        let center = footing.center();
        let aside = |slack: f64| Aside { slack, start: Some(start) };
        let at_center = self.compare(&center, &aside(0.0), found);
        let bound = self.referee.aside(&center);
        if footing.is_clear(bound) {
            return self.conclude(&center, &aside(0.0), at_center, &[], start, found);
        }
        // Next to the border the point itself may stand for it, or any point a little inside.
        let is_right = |stage: &Stage| matches!(stage, Stage::Right(_));
        let inner = footing.inner(bound);
        let compare = |(ray, slack): &(ExactRay, f64)| self.compare(ray, &aside(*slack), found);
        let stages: Vec<Stage> = inner.iter().map(compare).collect();
        if stages.iter().all(is_right) {
            return Judged { verdict: Verdict::Right, error: None };
        }
        let own = self.referee.meeting(&center, start, self.referee.aside(&center));
        let tunnelled = self.tunnelled(&inner, start, found);
        // Next to a single side, away from its ends, what a ray passes depends on its direction alone.
        let by_one_side = footing.is_by_one_side(bound);
        let verdict = if let Some(surely) = tunnelled.filter(|_| by_one_side) {
            self.late(&center, found, surely)
        } else if is_right(&at_center)
            || stages.iter().any(is_right)
            || own.is_none_or(|own| own.level)
            || footing.closer(bound).any(|sample| is_right(&compare(&sample)))
        {
            Verdict::TooClose
        } else if self.is_self_hit(&center, &inner, start, found) {
            Verdict::SelfHit
        } else if let Some(surely) = tunnelled {
            self.late(&center, found, surely)
        } else if matches!(at_center, Stage::Open) || stages.iter().any(|stage| matches!(stage, Stage::Open))
        {
            Verdict::TooClose
        } else {
            return self.conclude(&center, &aside(0.0), at_center, &inner, start, found);
        };
        Judged { verdict, error: None }
    }

    /// The verdict of the exact ray from the start itself, where it is clear of the triangle's border or where all samples object, too.
    fn conclude(
        &self,
        center: &ExactRay,
        aside: &Aside,
        stage: Stage,
        inner: &[(ExactRay, f64)],
        start: u32,
        found: Found,
    ) -> Judged {
        let verdict = match stage {
            Stage::Right(error) => return Judged { verdict: Verdict::Right, error },
            _ if self.is_self_hit(center, inner, start, found) => Verdict::SelfHit,
            Stage::Open => Verdict::TooClose,
            Stage::False => Verdict::FalseHit,
            Stage::Late if inner.is_empty() => self.late(center, found, true),
            Stage::Late | Stage::PerhapsLate if self.late_all_around(center, aside, found) => {
                self.late(center, found, matches!(stage, Stage::Late))
            }
            Stage::Late | Stage::PerhapsLate => Verdict::TooClose,
        };
        Judged { verdict, error: None }
    }

    /// Whether all samples say that the ray has passed through a surface of the start right there; if so, whether through the same triangle.
    fn tunnelled(&self, samples: &[(ExactRay, f64)], start: u32, found: Found) -> Option<bool> {
        let mut common: Option<Vec<u32>> = None;
        for (ray, slack) in samples {
            let passed = self.passed_at_start(ray, *slack, start, found);
            if passed.is_empty() {
                return None;
            }
            let known = common.get_or_insert_with(|| passed.clone());
            known.retain(|primitive| passed.contains(primitive));
        }
        common.map(|same| !same.is_empty())
    }

    /// The triangles of the start's surface that the ray, which starts `slack` from the true start, has passed through right there.
    fn passed_at_start(&self, ray: &ExactRay, slack: f64, start: u32, found: Found) -> Vec<u32> {
        let aside = Aside { slack, start: Some(start) };
        let t = found.map_or(f64::INFINITY, |(_, t)| t);
        let mut passed = self.referee.meetings(ray);
        passed.retain(|meeting| {
            let reach = meeting.uncertainty() + slack * meeting.steepness;
            aside.counts(meeting)
                && !meeting.level
                && !meeting.optional()
                && meeting.t <= reach
                && t > meeting.t + reach
                && self.belongs(ray, meeting.primitive, start)
                && !aside.excludes(&self.referee, meeting)
        });
        passed.into_iter().map(|meeting| meeting.primitive).collect()
    }

    /// `surely` if one triangle is met by all rays around, not each by another one: next to a border there may be gaps between those.
    fn late(&self, ray: &ExactRay, found: Found, surely: bool) -> Verdict {
        let bound = 2.0 * self.referee.aside(ray);
        match found {
            _ if !surely && self.border.iter().any(|edge| ray.passes_segment(edge, bound)) => {
                Verdict::TooClose
            }
            Some(_) => Verdict::Skipped,
            None if surely => Verdict::Miss,
            None => Verdict::Leak,
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
        // Of coincident triangles the least id is due.
        let twin = |meeting: &Meeting| {
            let [a, b] = [meeting.primitive, primitive].map(|id| self.referee.triangles[id as usize]);
            meeting.primitive < primitive && a == b && aside.counts(meeting)
        };
        // Also NaN.
        let ahead_of_it = t >= 0.0;
        if !ahead_of_it || !own.allows(t, aside.slack) || near.iter().any(twin) {
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

    /// Whether the answer is late for all rays around this one: each passes right there, on balance, from one side of the surface to the other.
    ///
    /// What folds back onto itself there, so that a ray enters and leaves at once, encloses nothing: its edges are rounded one by one, and may part.
    fn late_all_around(&self, ray: &ExactRay, aside: &Aside, found: Found) -> bool {
        let distance = self.referee.aside(ray);
        let reach = |meeting: &Meeting| meeting.uncertainty() + (aside.slack + distance) * meeting.steepness;
        // What was found may itself have been seen from as far aside.
        let t = found.map_or(f64::INFINITY, |(primitive, t)| {
            t - self.referee.meeting(ray, primitive, aside.slack).as_ref().map_or(0.0, reach)
        });
        let before = |ray: &ExactRay| {
            let mut before = self.referee.meetings(ray);
            before.retain(|meeting| {
                aside.counts(meeting)
                    && !aside.excludes(&self.referee, meeting)
                    && !meeting.optional()
                    && t > meeting.t + reach(meeting)
            });
            before
        };
        let around = ray.ring(distance).chain(self.referee.between_edges(ray, distance));
        let rings: Vec<Vec<Meeting>> = around.map(|moved| before(&moved)).collect();
        let all_near = self.referee.near(ray);
        before(ray).iter().any(|place| {
            // The way in may lie on a triangle that is seen edge-on: its t can be anything up to the answer's.
            if all_near.iter().any(|thin| !thin.surely && thin.spans(place.t, t, reach(thin))) {
                return false;
            }
            let near =
                |meeting: &Meeting| (meeting.t - place.t).abs() <= 4.0 * (reach(meeting) + reach(place));
            rings.iter().all(|ring| ring.iter().filter(|m| near(m)).map(Meeting::side).sum::<i32>() != 0)
        })
    }

    /// Whether the tracer met, at the start itself, a triangle that belongs to the start's surface and that none of the exact rays meets.
    fn is_self_hit(&self, center: &ExactRay, inner: &[(ExactRay, f64)], start: u32, found: Found) -> bool {
        let Some((primitive, t)) = found else { return false };
        if primitive == start {
            return true;
        }
        if !self.belongs(center, primitive, start) {
            return false;
        }
        let coincident = self.coplanar(start, primitive);
        let objects = |ray: &ExactRay, slack: f64| {
            // How far rounding and the sample's own distance from the start can bring the plane.
            let wide = 2.0 * slack + self.referee.aside(ray);
            let at_start = t * ray.length() <= 8.0 * wide;
            self.referee
                .meeting(ray, primitive, wide)
                .is_some_and(|own| !own.plane_is_ahead() && (coincident || (!own.level && at_start)))
        };
        objects(center, 0.0) && inner.iter().all(|(ray, slack)| objects(ray, *slack))
    }

    /// Whether two triangles share a vertex or a plane, and `center`, which starts on one, starts where they hang together.
    ///
    /// Triangles that share one vertex may also pierce each other, elsewhere or along a line from that vertex: no rounded start on that line can tell on which
    /// side of the other it lies.
    fn belongs(&self, center: &ExactRay, primitive: u32, start: u32) -> bool {
        let [own, other] = [start, primitive].map(|id| &self.referee.triangles[id as usize]);
        let Some(shared) = own.iter().find(|v| other.contains(v)) else {
            return self.coplanar(start, primitive);
        };
        let other = self.referee.exact(primitive);
        let sides = other.sides(own);
        let bound = self.referee.aside(center);
        !(sides.contains(&1) && sides.contains(&-1))
            || (center.distance(*shared) <= 64.0 * bound && center.distance_from_plane(other) > bound)
    }

    /// Whether all six vertices lie in one plane, exactly.
    fn coplanar(&self, one: u32, other: u32) -> bool {
        self.referee.exact(one).sides(&self.referee.triangles[other as usize]) == [0; 3]
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The second triangle pierces the first along a line from the vertex that they share. A start on that line, next to the vertex, may lie on either side of it
    /// as far as f64 knows.
    #[test]
    fn a_start_on_a_line_of_piercing_belongs_to_neither_side() {
        let shared = [-0.49560547, 0.375, 0.125];
        let own = [[-0.0048828125, 0.0, 0.375], [-0.0048828125, 0.0, -0.5], shared];
        let other = [[0.4951172, 0.0, 0.0], shared, [-0.0048828125, 0.0, 0.125]];
        let court = Court { referee: Referee::new(vec![own, other]), border: Vec::new() };
        let direction = DVec3::new(0.1583845621334364, -0.12101521649123316, 0.9799334915469414);
        let judge = |uv: [f64; 2], found| court.judge_spawned(0, uv, direction, found).verdict;
        let on_the_line = [9.036230243879023e-14, 0.9999999999996837];
        assert_eq!(judge(on_the_line, Some((1, 3.890176931192573e-17))), Verdict::TooClose);
        assert_ne!(judge(on_the_line, None), Verdict::SelfHit);
    }
}
