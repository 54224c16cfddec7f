//! Metals whose index of refraction has been measured.

use serde::Deserialize;

use super::Color;

/// A polished metal in air.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Metal {
    Gold,
    Silver,
    Copper,
    Aluminium,
}

impl Metal {
    /// Real and imaginary part of the index at 630, 532 and 465 nm, for red, green and blue: between the neighbours in the
    /// tables of Johnson and Christy, "Optical Constants of the Noble Metals", 1972, and for aluminium of Rakić, "Algorithm for
    /// the Determination of Intrinsic Optical Constants of Metal Films", 1995.
    pub fn index(self) -> (Color, Color) {
        match self {
            Metal::Gold => ([0.188, 0.544, 1.332], [3.403, 2.231, 1.869]),
            Metal::Silver => ([0.057, 0.054, 0.047], [4.254, 3.429, 2.803]),
            Metal::Copper => ([0.275, 1.080, 1.156], [3.373, 2.589, 2.468]),
            Metal::Aluminium => ([1.430, 0.939, 0.686], [7.508, 6.420, 5.635]),
        }
    }
}
