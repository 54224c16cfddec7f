//! The kinds of values in a scene file. Each refuses what can't be meant, at its own place in the text.

use std::fmt;
use std::marker::PhantomData;

use glam::DVec3;
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error as _, IntoDeserializer, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

/// A finite number.
#[derive(Clone, Copy, Debug)]
pub struct Finite(pub f64);

impl<'de> Deserialize<'de> for Finite {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let number = f64::deserialize(deserializer)?;
        if number.is_finite() {
            Ok(Finite(number))
        } else {
            Err(D::Error::custom(format_args!("expected a finite number, found {number}")))
        }
    }
}

/// A finite number that isn't negative.
#[derive(Clone, Copy, Debug)]
pub struct Amount(pub f64);

impl<'de> Deserialize<'de> for Amount {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let Finite(number) = Finite::deserialize(deserializer)?;
        if number < 0.0 {
            return Err(D::Error::custom(format_args!("expected a number of at least 0, found {number}")));
        }
        Ok(Amount(number))
    }
}

/// A point or vector, `[x, y, z]`.
#[derive(Clone, Copy, Debug)]
pub struct Vector(pub DVec3);

impl<'de> Deserialize<'de> for Vector {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let [x, y, z] = <[Finite; 3]>::deserialize(deserializer)?;
        Ok(Vector(DVec3::new(x.0, y.0, z.0)))
    }
}

/// One value or a list of them.
#[derive(Clone, Debug)]
pub enum OneOrList<T> {
    One(T),
    List(Vec<T>),
}

impl<T: Copy> OneOrList<T> {
    /// `N` values: one is repeated. `None` if it is a list of another length.
    pub fn spread<const N: usize>(&self) -> Option<[T; N]> {
        match self {
            OneOrList::One(value) => Some([*value; N]),
            OneOrList::List(list) => list.as_slice().try_into().ok(),
        }
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for OneOrList<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either<T>(PhantomData<T>);

        impl<'de, T: Deserialize<'de>> Visitor<'de> for Either<T> {
            type Value = OneOrList<T>;

            fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
                formatter.write_str("a number or a list of numbers")
            }

            fn visit_i64<E: serde::de::Error>(self, value: i64) -> Result<Self::Value, E> {
                T::deserialize(value.into_deserializer()).map(OneOrList::One)
            }

            fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<Self::Value, E> {
                T::deserialize(value.into_deserializer()).map(OneOrList::One)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
                let mut values = Vec::new();
                while let Some(value) = list.next_element()? {
                    values.push(value);
                }
                Ok(OneOrList::List(values))
            }
        }

        deserializer.deserialize_any(Either(PhantomData))
    }
}

/// A colour: `[r, g, b]`, or one number for all three.
#[derive(Clone, Copy, Debug)]
pub struct Rgb(pub [f64; 3]);

impl<'de> Deserialize<'de> for Rgb {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match OneOrList::<Amount>::deserialize(deserializer)?.spread() {
            Some(channels) => Ok(Rgb(channels.map(|Amount(channel)| channel))),
            None => Err(D::Error::custom("expected a number or [r, g, b]")),
        }
    }
}

/// A rotation: `[x, y, z]` in degrees, or `{ axis = [x, y, z], angle = degrees }`.
#[derive(Clone, Copy, Debug)]
pub enum Rotation {
    /// About x, then y, then z.
    Axes([f64; 3]),
    About {
        axis: DVec3,
        angle: f64,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AxisAngle {
    axis: Vector,
    angle: Finite,
}

impl<'de> Deserialize<'de> for Rotation {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either;

        impl<'de> Visitor<'de> for Either {
            type Value = Rotation;

            fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
                formatter.write_str("[x, y, z] in degrees or { axis = [x, y, z], angle = degrees }")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Rotation, A::Error> {
                let mut angles = [0.0; 3];
                for (count, angle) in angles.iter_mut().enumerate() {
                    match list.next_element::<Finite>()? {
                        Some(Finite(degrees)) => *angle = degrees,
                        None => return Err(A::Error::invalid_length(count, &self)),
                    }
                }
                match list.next_element::<Finite>()? {
                    None => Ok(Rotation::Axes(angles)),
                    Some(_) => Err(A::Error::invalid_length(4, &self)),
                }
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Rotation, A::Error> {
                let AxisAngle { axis, angle } = AxisAngle::deserialize(MapAccessDeserializer::new(map))?;
                Ok(Rotation::About { axis: axis.0, angle: angle.0 })
            }
        }

        deserializer.deserialize_any(Either)
    }
}
