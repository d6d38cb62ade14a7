//! Why an end does not do what its program asks for.

use core::fmt;

/// Why an end refuses a request of its own program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Refused {
    /// The model has no such element.
    Element,
    /// Elements of this kind cannot do that.
    Kind,
    /// The bytes are not as many as the model says.
    Size,
    /// As many wait as can be held.
    Full,
    /// There is no session.
    NoSession,
    /// The element is deactivated, or its activation is not under way yet.
    Inactive,
    /// The period is not one of [`PERIODS`](crate::PERIODS).
    Period,
    /// A number is not finite, or the sum of increments that the robot has not confirmed does not fit its type.
    Value,
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Refused::Element => "the model has no such element",
            Refused::Kind => "elements of this kind cannot do that",
            Refused::Size => "the bytes are not as many as the model says",
            Refused::Full => "as many wait as can be held",
            Refused::NoSession => "there is no session",
            Refused::Inactive => "the element is deactivated",
            Refused::Period => "the period is not between 1 and 200 ms",
            Refused::Value => {
                "a number is not finite, or the increments add up to more than their type holds"
            }
        })
    }
}

impl core::error::Error for Refused {}
