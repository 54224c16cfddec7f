//! Renders on demand: rank 0 says which, all ranks do it. Must not know why.

use std::time::Instant;

use serde::{Deserialize, Serialize};

use crate::accel::Trace;
use crate::cluster::share::computed;
use crate::error::Result;
use crate::job::{self, Crew, Rendered, Work};
use crate::lab::ladder::textbook::{Precision, Textbook};
use crate::output::stats::{RankStats, Stats};
use crate::settings::ImageSettings;

/// All ranks with their work, as rank 0 sees them.
pub struct Stage<'a> {
    crew: &'a Crew<'a>,
    works: Vec<Work>,
    /// What answers in other arithmetic than the renderer's, by number of the work; made when it is first asked.
    textbooks: Vec<(u32, Textbook)>,
    /// After an error of a render nobody knows where the other ranks are.
    in_step: bool,
}

/// One render, by its number among the works.
#[derive(Serialize, Deserialize)]
struct Order {
    work: u32,
    precision: Precision,
    image: ImageSettings,
}

/// What came of a render.
#[derive(Clone, Debug)]
pub struct Shot {
    pub rendered: Rendered,
    /// Wall seconds of the render phase: from the first look at the image to its last pixel on rank 0.
    pub seconds: f64,
    /// The longest trace of any rank, which is most of that.
    pub trace_seconds: f64,
    /// Of all ranks.
    pub rays: u64,
    pub threads: u32,
}

/// Collective: distributes rank 0's `works`; then rank 0 leads, and the others render what it says until it is done. Rank 0 gets what `lead` made.
///
/// # Errors
/// Those of `lead` and of any render, on all ranks.
pub fn perform<T>(
    crew: &Crew,
    mut works: Vec<Work>,
    lead: impl FnOnce(&mut Stage) -> Result<T>,
) -> Result<Option<T>> {
    let count = computed(crew.comm, || Ok(works.len() as u64))?;
    works.resize_with(count as usize, Work::default);
    works.iter_mut().try_for_each(|work| job::distribute(crew, work))?;
    let mut stage = Stage { crew, works, textbooks: Vec::new(), in_step: true };
    if crew.comm.rank() > 0 {
        while let Some(order) = computed(crew.comm, || Ok(None))? {
            stage.render(&order)?;
        }
        return Ok(None);
    }
    let led = lead(&mut stage);
    if !stage.in_step {
        return led.map(Some);
    }
    let mut made = None;
    computed(crew.comm, || {
        made = Some(led?);
        Ok(None::<Order>)
    })?;
    Ok(made)
}

impl Stage<'_> {
    /// On rank 0: renders a work with these settings, its rays answered in this arithmetic.
    pub fn shoot(&mut self, work: usize, precision: Precision, image: &ImageSettings) -> Result<Shot> {
        let order = Order { work: work as u32, precision, image: image.clone() };
        self.in_step = false;
        let order = computed(self.crew.comm, || Ok(Some(order)))?;
        let shot = order.map(|order| self.render(&order)).transpose()?.flatten();
        self.in_step = true;
        Ok(shot.expect("rank 0 has the image"))
    }

    fn render(&mut self, order: &Order) -> Result<Option<Shot>> {
        let Stage { crew, works, textbooks, .. } = self;
        let comm = crew.comm;
        let work = &mut works[order.work as usize];
        work.image = order.image.clone();
        let is_asked =
            |(work, book): &&(u32, Textbook)| (*work, book.precision()) == (order.work, order.precision);
        if !textbooks.iter().any(|book| is_asked(&book))
            && let Some(book) = Textbook::new(order.precision, &work.scene.surfaces)
        {
            textbooks.push((order.work, book));
        }
        let tracer = textbooks.iter().find(is_asked).map(|(_, book)| book as &dyn Trace);
        let threads = crew.pool.current_num_threads() as u32;
        let mut stats = RankStats { rank: comm.rank() as u32, threads, ..RankStats::default() };
        comm.barrier();
        let begin = Instant::now();
        let rendered = job::render_by(crew, work, tracer, &mut stats)?;
        let seconds = begin.elapsed().as_secs_f64();
        let ranks = job::gather_stats(comm, &stats)?;
        Ok(rendered.zip(ranks).map(|(rendered, ranks)| {
            let (width, height) = (rendered.image.width, rendered.image.height);
            let totals = Stats::new(width, height, order.image.spp, seconds, ranks).totals;
            let (trace_seconds, rays, threads) = (totals.trace_seconds, totals.all_rays, totals.threads);
            Shot { rendered, seconds, trace_seconds, rays, threads }
        }))
    }
}
