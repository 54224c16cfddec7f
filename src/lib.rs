//! heliostat: a distributed-memory parallel ray tracer, exact and the same bytes however it was run.
//!
//! [`render_alone`] renders in this process; [`job::render`] is the same over ranks. A scene file goes through [`scene::load`], its rays
//! through [`accel`] as records ([`geometry::record`]), their light through [`transport`] into the film ([`render::film`]).
//!
//! ```
//! use heliostat::scene::load;
//! use heliostat::settings::{ImageSettings, RunSettings};
//!
//! let loaded = load::load("scenes/orthographic.toml".as_ref())?;
//! let image = heliostat::render_alone(loaded.scene, ImageSettings::sized(160, 120), RunSettings::default())?;
//! println!("centre: {:?}", image.pixels[60 * 160 + 80]);
//! # Ok::<(), heliostat::error::Error>(())
//! ```

pub mod accel;
pub mod cli;
pub mod cluster;
pub mod error;
pub mod geometry;
pub mod image;
pub mod job;
pub mod lab;
pub mod memory;
pub mod output;
pub mod render;
pub mod scene;
pub mod settings;
pub mod simd;
pub mod transport;
pub mod wire;

pub use job::render_alone;

/// The README's examples are tested.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
