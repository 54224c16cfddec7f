//! What several tables ask of their keys: which may be there, which must, and in what range.

use std::fmt::Display;
use std::ops::RangeInclusive;

use ::toml::Spanned;

use super::source::{Source, Span};
use super::value::Finite;
use crate::error::{Error, Result};

impl Source<'_> {
    /// Refuses keys that exist but mean nothing for this type of thing.
    pub fn only(&self, what: &str, keys: &[(&'static str, Span)], known: &[&[&str]]) -> Result<()> {
        let stranger = keys.iter().find(|(key, _)| !known.iter().any(|list| list.contains(key)));
        match stranger {
            None => Ok(()),
            Some((key, at)) => Err(self.error(
                at,
                format_args!("`{key}` means nothing for {what}"),
                format!("remove it, or use one of {}", known.concat().join(", ")),
            )),
        }
    }

    /// The value of a key that must be there. `table` is where the table begins.
    pub fn required<T>(
        &self,
        value: Option<Spanned<T>>,
        table: &Span,
        what: &str,
        key: &str,
    ) -> Result<Spanned<T>> {
        value.ok_or_else(|| {
            self.error(table, format_args!("{what} without `{key}`"), format!("add `{key} = …`"))
        })
    }

    /// A number that passes `test`, which `range` puts into words; or the default.
    pub fn number(
        &self,
        value: Option<Spanned<Finite>>,
        default: f64,
        key: &str,
        test: impl Fn(f64) -> bool,
        range: &str,
    ) -> Result<f64> {
        let Some(value) = value else { return Ok(default) };
        let Finite(number) = *value.get_ref();
        if test(number) { Ok(number) } else { Err(self.outside(&value.span(), key, number, range)) }
    }

    /// A number above 0, or the default.
    pub fn positive(&self, value: Option<Spanned<Finite>>, default: f64, key: &str) -> Result<f64> {
        self.number(value, default, key, |x| x > 0.0, "above 0")
    }

    /// A whole number in `range`, or `None`.
    pub fn whole(
        &self,
        value: Option<Spanned<u32>>,
        key: &str,
        range: RangeInclusive<u32>,
    ) -> Result<Option<u32>> {
        let Some(value) = value else { return Ok(None) };
        let number = *value.get_ref();
        if range.contains(&number) {
            Ok(Some(number))
        } else {
            let range = format!("from {} to {}", range.start(), range.end());
            Err(self.outside(&value.span(), key, number, &range))
        }
    }

    pub fn outside(&self, at: &Span, key: &str, found: impl Display, range: &str) -> Error {
        self.error(at, format_args!("`{key}` is {found}"), format!("give a number {range}"))
    }
}
