//! How the rays of a batch go through the tree.

/// How the rays of a batch go through the tree. The answers are the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Traversal {
    /// As suits each bundle of rays: together where they go much the same way, else in flight.
    Chosen,
    /// Many in flight, each on its own way.
    Flights,
    /// One after the other.
    Single,
}

impl Traversal {
    pub const ALL: [Traversal; 3] = [Traversal::Chosen, Traversal::Flights, Traversal::Single];

    pub fn name(self) -> &'static str {
        match self {
            Traversal::Chosen => "chosen",
            Traversal::Flights => "flights",
            Traversal::Single => "single",
        }
    }
}
