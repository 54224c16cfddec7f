//! The path integrator as a whole, judged by statistics: white furnaces, closed forms, radiosity, estimators against each other, and errors that must be
//! found. All numbers come from fixed seeds, so that a test that passes passes always.

mod closed_forms;
#[path = "../common/mod.rs"]
mod common;
mod correlation;
mod estimators;
mod furnace;
mod geometry;
mod judge;
mod radiosity;
mod sky;
mod stage;
mod text;
