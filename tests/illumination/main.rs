//! Light as the formulas say: tiny scenes rendered by the library against values computed here by hand.

mod bounces;
mod film;
mod local;
mod shading;
mod shadows;
mod tiny;
mod world;
