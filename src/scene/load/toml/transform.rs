//! From `translate`, `rotate`, `scale` or `matrix` to an affine map; and angles in degrees.

use glam::{DAffine3, DMat3, DVec3};

use super::source::{Source, Span};
use super::tables::Object;
use super::value::{Finite, Rotation};
use crate::error::Result;

/// The object's place: scaled, then rotated, then translated; or its matrix.
///
/// # Errors
/// A matrix beside other keys, a last row other than 0 0 0 1, a map that flattens or isn't finite.
pub fn transform(source: &Source, object: &Object) -> Result<DAffine3> {
    let (place, at) = match &object.matrix {
        Some(matrix) => {
            let beside = [
                object.translate.as_ref().map(|value| ("translate", value.span())),
                object.rotate.as_ref().map(|value| ("rotate", value.span())),
                object.scale.as_ref().map(|value| ("scale", value.span())),
            ];
            if let Some((key, at)) = beside.into_iter().flatten().next() {
                return Err(source.error(
                    &at,
                    format_args!("`{key}` beside `matrix`"),
                    "leave one of them out",
                ));
            }
            let at = matrix.span();
            let rows = matrix.get_ref().map(|row| row.map(|Finite(number)| number));
            if rows[3] != [0.0, 0.0, 0.0, 1.0] {
                return Err(source.error(
                    &at,
                    "the matrix's last row isn't 0 0 0 1",
                    "write the matrix by rows, the translation in the last column",
                ));
            }
            let column = |k: usize| DVec3::new(rows[0][k], rows[1][k], rows[2][k]);
            (DAffine3::from_cols(column(0), column(1), column(2), column(3)), at)
        }
        None => (composed(source, object)?, object.scale.as_ref().map_or(0..0, |scale| scale.span())),
    };
    let determinant = place.matrix3.determinant();
    if determinant == 0.0 || !determinant.is_finite() {
        return Err(source.error(
            &at,
            "the transform flattens the object, or leaves the range of numbers",
            "scale by numbers that aren't 0 or huge",
        ));
    }
    Ok(place)
}

fn composed(source: &Source, object: &Object) -> Result<DAffine3> {
    let translation = object.translate.as_ref().map_or(DVec3::ZERO, |value| value.get_ref().0);
    let scale = match &object.scale {
        None => DVec3::ONE,
        Some(scale) => match scale.get_ref().spread() {
            Some(factors) => DVec3::from(factors.map(|Finite(factor)| factor)),
            None => {
                let expected = "`scale` needs one number or three";
                return Err(source.error(&scale.span(), expected, "give a factor, or [x, y, z]"));
            }
        },
    };
    let rotation = match &object.rotate {
        None => DMat3::IDENTITY,
        Some(rotate) => match *rotate.get_ref() {
            Rotation::Axes([x, y, z]) => about(DVec3::Z, z) * about(DVec3::Y, y) * about(DVec3::X, x),
            Rotation::About { axis, angle } => about(unit(source, &rotate.span(), axis, "axis")?, angle),
        },
    };
    Ok(DAffine3 { matrix3: rotation * DMat3::from_diagonal(scale), translation })
}

/// The unit vector along `vector`, the value of `key`.
///
/// # Errors
/// A vector of no (or endless) length.
pub fn unit(source: &Source, at: &Span, vector: DVec3, key: &str) -> Result<DVec3> {
    vector.try_normalize().ok_or_else(|| {
        source.error(at, format_args!("`{key}` has no direction"), "give a vector whose length isn't 0")
    })
}

/// Rotation by `degrees` about a unit vector, counter-clockwise seen from its tip.
fn about(axis: DVec3, degrees: f64) -> DMat3 {
    let (sin, cos) = sin_cos(degrees);
    let column = |v: DVec3| v * cos + axis.cross(v) * sin + axis * (axis.dot(v) * (1.0 - cos));
    DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z))
}

/// Sine and cosine of an angle in degrees; exact at quarter turns, so that what was turned by 90 degrees is still
/// aligned with the axes.
pub fn sin_cos(degrees: f64) -> (f64, f64) {
    let quarters = (degrees / 90.0).round();
    let (sin, cos) = libm::sincos((degrees - quarters * 90.0).to_radians());
    match quarters.rem_euclid(4.0) as u8 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles() {
        assert_eq!(sin_cos(90.0), (1.0, 0.0));
        assert_eq!(sin_cos(-90.0), (-1.0, 0.0));
        assert_eq!(sin_cos(180.0), (0.0, -1.0));
        assert_eq!(sin_cos(720.0), (0.0, 1.0));
        for degrees in [-400.0, -91.0, 12.5, 44.0, 46.0, 135.0, 224.9, 300.0] {
            let (sin, cos) = sin_cos(degrees);
            let (s, c) = libm::sincos(f64::to_radians(degrees));
            assert!((sin - s).abs() < 1e-14 && (cos - c).abs() < 1e-14, "{degrees}");
        }
        assert!(sin_cos(1e300).0.is_finite());
    }

    #[test]
    fn turns_counter_clockwise() {
        assert_eq!(about(DVec3::Z, 90.0) * DVec3::X, DVec3::Y);
        assert_eq!(about(DVec3::X, 90.0) * DVec3::Y, DVec3::Z);
        assert_eq!(about(DVec3::Y, 90.0) * DVec3::Z, DVec3::X);
    }
}
