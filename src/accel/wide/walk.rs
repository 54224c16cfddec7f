//! A batch of rays from its questions to its answers, in bundles of 64.
//!
//! What counts as a hit is decided in f64 by `Tester` alone, and by `finish` in the same way. That decision is put off: a triangle that is surely met, at a t known to
//! within bounds, ends the search behind it as well as a decided one. Only where the f32 filter is unsure, or two bounds overlap, f64 decides at once; else only of the last
//! candidate, when the walk is over. Should it then contradict a bound (it never has), the ray is walked again without putting anything off.

use super::bundle::{Bundle, RAYS, first_lanes};
use super::finish::Decisions;
use super::flight::{self, Stacks, Tickets};
use super::lanes::{Eight, Plain, Vector};
use super::lone::{self, Lone};
use super::packet::{self, Entry};
use super::questions::{Batch, Questions, Walked};
use super::slices::Gathered;
use super::traversal::Traversal;
use crate::geometry::record::Answer;

/// Bundles whose rays are in flight together.
const TOGETHER: usize = 8;

/// What is kept between batches.
pub struct Scratch {
    /// One more than are in flight together, for rays that are walked again.
    pub bundles: Vec<Box<Bundle>>,
    /// Those of all bundles that go alone, each at the place of its lane.
    pub rays: Vec<Lone>,
    pub stacks: Stacks,
    pub entries: Vec<Entry>,
    /// What packets have met in cells.
    pub gathered: Option<Box<Gathered>>,
    decisions: Box<Decisions>,
    tickets: Vec<u16>,
}

impl Default for Scratch {
    fn default() -> Self {
        Scratch {
            bundles: (0..=TOGETHER).map(|_| Bundle::empty()).collect(),
            rays: vec![Lone::NONE; (TOGETHER + 1) * RAYS],
            stacks: Stacks::default(),
            entries: Vec::new(),
            gathered: None,
            decisions: Decisions::new(),
            tickets: Vec::with_capacity(TOGETHER * RAYS),
        }
    }
}

/// A level's vectors, and what is compiled for it.
///
/// # Safety
/// Methods may be called only where the level's instructions are there.
pub unsafe trait Instructions {
    /// For one ray and the children of a node or the triangles of a block.
    type Eight: Eight;
    /// For many rays.
    type Most: Vector;

    /// [`Bundle::fill`].
    unsafe fn fill(
        batch: &Batch,
        questions: &impl Questions,
        bundle: &mut Bundle,
        first: usize,
        count: usize,
    );
    /// [`packet::packets`].
    unsafe fn packets(batch: &Batch, number: usize, scratch: &mut Scratch) -> u64;
    /// [`lone::set_out`].
    unsafe fn set_out(walked: &Walked, bundle: &Bundle, lanes: u64, rays: &mut [Lone]) -> u64;
    /// [`flight::fly`].
    unsafe fn fly(
        batch: &Batch,
        bundles: &mut [Box<Bundle>],
        rays: &mut [Lone],
        tickets: &Tickets,
        stacks: &mut Stacks,
    );
    /// [`Decisions::finish`].
    unsafe fn finish(batch: &Batch, decisions: &mut Decisions, bundle: &mut Bundle, answers: &mut [Answer]);
}

macro_rules! instructions {
    ($(#[doc = $doc:literal])* $name:ident, $eight:ty, $most:ty, $(#[$features:meta])*) => {
        $(#[doc = $doc])*
        pub struct $name;

        // SAFETY: each method passes on what its caller promises.
        unsafe impl Instructions for $name {
            type Eight = $eight;
            type Most = $most;

            unsafe fn fill(
                batch: &Batch,
                questions: &impl Questions,
                bundle: &mut Bundle,
                first: usize,
                count: usize,
            ) {
                $(#[$features])*
                unsafe fn compiled(
                    batch: &Batch,
                    questions: &impl Questions,
                    bundle: &mut Bundle,
                    first: usize,
                    count: usize,
                ) {
                    // SAFETY: the caller's promise.
                    unsafe { bundle.fill::<$eight>(batch, questions, first, count) };
                }
                // SAFETY: the caller's promise.
                unsafe { compiled(batch, questions, bundle, first, count) }
            }

            unsafe fn packets(batch: &Batch, number: usize, scratch: &mut Scratch) -> u64 {
                $(#[$features])*
                unsafe fn compiled(
                    batch: &Batch,
                    number: usize,
                    scratch: &mut Scratch,
                ) -> u64 {
                    // SAFETY: the caller's promise.
                    unsafe { packet::packets::<$name>(batch, number, scratch) }
                }
                // SAFETY: the caller's promise.
                unsafe { compiled(batch, number, scratch) }
            }

            unsafe fn set_out(walked: &Walked, bundle: &Bundle, lanes: u64, rays: &mut [Lone]) -> u64 {
                $(#[$features])*
                unsafe fn compiled(walked: &Walked, bundle: &Bundle, lanes: u64, rays: &mut [Lone]) -> u64 {
                    // SAFETY: the caller's promise.
                    unsafe { lone::set_out::<$eight>(walked, bundle, lanes, rays) }
                }
                // SAFETY: the caller's promise.
                unsafe { compiled(walked, bundle, lanes, rays) }
            }

            unsafe fn fly(
                batch: &Batch,
                bundles: &mut [Box<Bundle>],
                rays: &mut [Lone],
                tickets: &Tickets,
                stacks: &mut Stacks,
            ) {
                $(#[$features])*
                unsafe fn compiled(
                    batch: &Batch,
                    bundles: &mut [Box<Bundle>],
                    rays: &mut [Lone],
                    tickets: &Tickets,
                    stacks: &mut Stacks,
                ) {
                    // SAFETY: the caller's promise.
                    unsafe { flight::fly::<$eight>(batch, bundles, rays, tickets, stacks) }
                }
                // SAFETY: the caller's promise.
                unsafe { compiled(batch, bundles, rays, tickets, stacks) }
            }

            unsafe fn finish(
                batch: &Batch,
                decisions: &mut Decisions,
                bundle: &mut Bundle,
                answers: &mut [Answer],
            ) {
                $(#[$features])*
                unsafe fn compiled(
                    batch: &Batch,
                    decisions: &mut Decisions,
                    bundle: &mut Bundle,
                    answers: &mut [Answer],
                ) {
                    decisions.finish(batch, bundle, answers);
                }
                // SAFETY: the caller's promise.
                unsafe { compiled(batch, decisions, bundle, answers) }
            }
        }
    };
}

instructions!(
    /// What every processor of the architecture has.
    Baseline,
    Plain,
    Plain,
);

#[cfg(target_arch = "x86_64")]
instructions!(
    /// AVX2 and FMA.
    Avx2,
    super::lanes::Avx2,
    super::lanes::Avx2,
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
);

#[cfg(target_arch = "x86_64")]
instructions!(
    /// AVX-512 F, VL, DQ and BW.
    Avx512,
    super::lanes::Avx512,
    super::lanes::Sixteen,
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512vl,avx512dq,avx512bw")]
);

/// Answers all rays of a batch, in their order.
///
/// # Safety
/// The level's instructions are there.
pub unsafe fn walk<I: Instructions>(
    walked: &Walked,
    traversal: Traversal,
    questions: &impl Questions,
    answers: &mut [Answer],
    scratch: &mut Scratch,
) {
    let batch = Batch { walked, questions };
    let mut bundles = 0;
    scratch.tickets.clear();
    for first in (0..answers.len()).step_by(RAYS) {
        let count = (answers.len() - first).min(RAYS);
        // SAFETY: the caller's promise.
        unsafe {
            I::fill(&batch, questions, &mut scratch.bundles[bundles], first, count);
            let mut alone = match traversal {
                Traversal::Chosen => I::packets(&batch, bundles, scratch),
                Traversal::Flights | Traversal::Single => first_lanes(count),
            };
            if alone != 0 {
                let rays = &mut scratch.rays[bundles * RAYS..];
                alone = I::set_out(walked, &scratch.bundles[bundles], alone, rays);
            }
            if alone == 0 {
                finish::<I>(&batch, bundles, answers, scratch);
                continue;
            }
            while alone != 0 {
                scratch.tickets.push((bundles * RAYS) as u16 + alone.trailing_zeros() as u16);
                alone &= alone - 1;
            }
            bundles += 1;
            if bundles == TOGETHER {
                fly::<I>(&batch, traversal, bundles, answers, scratch);
                bundles = 0;
            }
        }
    }
    if bundles > 0 {
        // SAFETY: the caller's promise.
        unsafe { fly::<I>(&batch, traversal, bundles, answers, scratch) };
    }
}

/// Answers the rays of a batch that go through cells in packets; the others are named.
///
/// # Safety
/// The level's instructions are there.
pub unsafe fn through_cells<I: Instructions>(
    walked: &Walked,
    questions: &impl Questions,
    answers: &mut [Answer],
    scratch: &mut Scratch,
    alone: &mut Vec<usize>,
) {
    let batch = Batch { walked, questions };
    for first in (0..answers.len()).step_by(RAYS) {
        let count = (answers.len() - first).min(RAYS);
        scratch.gathered.get_or_insert_default().clear();
        // SAFETY: the caller's promise.
        unsafe {
            I::fill(&batch, questions, &mut scratch.bundles[0], first, count);
            let mut left = I::packets(&batch, 0, scratch);
            let Scratch { bundles, decisions, gathered, .. } = &mut *scratch;
            if left != first_lanes(count) {
                let tree = gathered.get_or_insert_default().view();
                let walked = Walked { tree, ..*walked };
                I::finish(&Batch { walked: &walked, ..batch }, decisions, &mut bundles[0], answers);
                left |= bundles[0].contradicted;
            }
            while left != 0 {
                alone.push(first + left.trailing_zeros() as usize);
                left &= left - 1;
            }
        }
    }
}

/// Lets the rays of all tickets fly, and finishes the first bundles.
///
/// # Safety
/// The level's instructions are there.
unsafe fn fly<I: Instructions>(
    batch: &Batch,
    traversal: Traversal,
    bundles: usize,
    answers: &mut [Answer],
    scratch: &mut Scratch,
) {
    let at_once = if traversal == Traversal::Single { 1 } else { TOGETHER * RAYS };
    for tickets in scratch.tickets.chunks(at_once) {
        let tickets = Tickets { tickets, from: 0, lazy: true };
        // SAFETY: the caller's promise.
        unsafe { I::fly(batch, &mut scratch.bundles, &mut scratch.rays, &tickets, &mut scratch.stacks) };
    }
    scratch.tickets.clear();
    for number in 0..bundles {
        // SAFETY: the caller's promise.
        unsafe { finish::<I>(batch, number, answers, scratch) };
    }
}

/// Answers the rays of a bundle.
///
/// # Safety
/// The level's instructions are there.
unsafe fn finish<I: Instructions>(
    batch: &Batch,
    number: usize,
    answers: &mut [Answer],
    scratch: &mut Scratch,
) {
    let Scratch { bundles, decisions, .. } = &mut *scratch;
    let bundle = &mut *bundles[number];
    // SAFETY: the caller's promise.
    unsafe { I::finish(batch, decisions, bundle, answers) };
    let (first, mut again) = (bundle.first, bundle.contradicted);
    while again != 0 {
        let index = first + again.trailing_zeros() as usize;
        again &= again - 1;
        // SAFETY: the caller's promise.
        unsafe {
            I::fill(batch, &batch.questions, &mut scratch.bundles[TOGETHER], index, 1);
            scratch.rays[TOGETHER * RAYS].take(&scratch.bundles[TOGETHER], 0);
            let tickets = Tickets { tickets: &[(TOGETHER * RAYS) as u16], from: 0, lazy: false };
            I::fly(batch, &mut scratch.bundles, &mut scratch.rays, &tickets, &mut scratch.stacks);
        }
        answers[index] = scratch.bundles[TOGETHER].answer(batch, 0);
    }
}
