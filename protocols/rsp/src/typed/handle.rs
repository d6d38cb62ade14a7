//! An element at the middle, as a program uses it (S7, figure 4).

use alloc::vec::Vec;
use core::marker::PhantomData;

use crate::Refused;
use crate::middle::{Middle, Reading};

use super::{Bytes, Command, Effector, Named, Numbers, Plain, Sensor, Unsent, decode_list, encode_list};

/// A value, and since when it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known<V> {
    /// The value.
    pub value: V,
    /// When it was heard, in µs of the middle's clock.
    pub at: u64,
    /// When the robot said it, in ms of the robot's clock.
    pub stamp: u32,
}

/// An element at the middle.
pub struct Handle<'a, 'm, N> {
    middle: &'a mut Middle<'m>,
    element: PhantomData<N>,
}

impl<'a, 'm, N: Named> Handle<'a, 'm, N> {
    /// The element of a middle whose layout is that of the element's model.
    #[must_use]
    pub fn new(middle: &'a mut Middle<'m>) -> Handle<'a, 'm, N> {
        Handle {
            middle,
            element: PhantomData,
        }
    }

    /// Wants it activated or not; a module, its members.
    ///
    /// # Errors
    ///
    /// [`Refused`], if the middle's layout has no such element.
    pub fn set_activated(&mut self, activated: bool) -> Result<(), Refused> {
        self.middle.set_activated(N::PLACE, activated)
    }

    /// Whether it is wanted.
    #[must_use]
    pub fn is_activated(&self) -> bool {
        self.middle.activated(N::PLACE)
    }

    /// Whether the robot has confirmed that it is active.
    #[must_use]
    pub fn is_active(&self) -> bool {
        self.middle.active(N::PLACE)
    }

    /// Asks for it now: for a sensor's value, or for the memory events that the robot holds.
    ///
    /// # Errors
    ///
    /// [`Refused`], for other elements.
    pub fn ask(&mut self) -> Result<(), Refused> {
        self.middle.ask(N::PLACE)
    }
}

impl<N: Effector + Numbers> Handle<'_, '_, N> {
    /// Writes a value; of an incremental effector, a step.
    ///
    /// # Errors
    ///
    /// [`Unsent`]: it is outside the range, or there is no session.
    pub fn write(&mut self, value: N::Value) -> Result<(), Unsent> {
        let bytes = N::encode(value).ok_or(Unsent::Range)?;
        Ok(self.middle.write(N::PLACE, bytes.as_ref())?)
    }

    /// Writes one number of it, in its unit, and leaves the others.
    ///
    /// # Errors
    ///
    /// [`Unsent`]: there is no such number, it is outside the range, or there is no session.
    pub fn write_at(&mut self, index: usize, number: f64) -> Result<(), Unsent> {
        let wanted = match N::LIMITED {
            true => self.middle.wanted(N::PLACE).and_then(decode_list::<N>),
            // The other steps are none.
            false => None,
        };
        let mut list = wanted.unwrap_or(N::LIST);
        *list.as_mut().get_mut(index).ok_or(Unsent::Range)? = number;
        let bytes = encode_list::<N>(list).ok_or(Unsent::Range)?;
        Ok(self.middle.write(N::PLACE, bytes.as_ref())?)
    }

    /// The value that was written last.
    #[must_use]
    pub fn wanted(&self) -> Option<N::Value> {
        self.middle.wanted(N::PLACE).and_then(N::decode)
    }

    /// The value that the robot has acknowledged.
    #[must_use]
    pub fn confirmed(&self) -> Option<Known<N::Value>> {
        known(self.middle.confirmed(N::PLACE)?, N::decode)
    }
}

impl<N: Effector + Bytes> Handle<'_, '_, N> {
    /// Writes bytes that fit a packet.
    ///
    /// # Errors
    ///
    /// [`Refused`]: they are too many, or there is no session.
    pub fn write_bytes(&mut self, bytes: &[u8]) -> Result<(), Refused> {
        self.middle.write(N::PLACE, bytes)
    }

    /// Sends bytes in fragments, and gives the number of the blob.
    ///
    /// # Errors
    ///
    /// [`Refused`]: they are too many, or there is no session.
    pub fn send_blob(&mut self, bytes: &[u8]) -> Result<u16, Refused> {
        self.middle.send_blob(N::PLACE, bytes)
    }
}

impl<N: Sensor + Numbers> Handle<'_, '_, N> {
    /// The newest value.
    #[must_use]
    pub fn read(&self) -> Option<Known<N::Value>> {
        known(self.middle.read(N::PLACE)?, N::decode)
    }

    /// One number of the newest value, in its unit.
    #[must_use]
    pub fn read_at(&self, index: usize) -> Option<f64> {
        let list = decode_list::<N>(self.middle.read(N::PLACE)?.value)?;
        list.as_ref().get(index).copied()
    }

    /// Several numbers of one value, each in its unit.
    #[must_use]
    pub fn read_list(&self, indices: &[usize]) -> Option<Vec<f64>> {
        let list = decode_list::<N>(self.middle.read(N::PLACE)?.value)?;
        let number = |index: &usize| list.as_ref().get(*index).copied();
        indices.iter().map(number).collect()
    }
}

impl<N: Sensor + Bytes> Handle<'_, '_, N> {
    /// The newest bytes that came in a packet. Blobs come as notices.
    #[must_use]
    pub fn read_bytes(&self) -> Option<Reading<'_>> {
        self.middle.read(N::PLACE)
    }
}

impl<N: Command + Numbers> Handle<'_, '_, N> {
    /// Sends the command, and gives its ticket.
    ///
    /// # Errors
    ///
    /// [`Unsent`]: a number is outside its range, too many commands wait, or there is no session.
    pub fn send(&mut self, value: N::Value) -> Result<u32, Unsent> {
        let bytes = N::encode(value).ok_or(Unsent::Range)?;
        Ok(self.middle.command(N::PLACE, bytes.as_ref())?)
    }
}

impl<N: Command + Plain> Handle<'_, '_, N> {
    /// Sends the command, and gives its ticket.
    ///
    /// # Errors
    ///
    /// [`Refused`]: too many commands wait, or there is no session.
    pub fn send_plain(&mut self) -> Result<u32, Refused> {
        self.middle.command(N::PLACE, &[])
    }
}

impl<N: Command + Bytes> Handle<'_, '_, N> {
    /// Sends the command, and gives its ticket.
    ///
    /// # Errors
    ///
    /// [`Refused`]: the bytes are too many, too many commands wait, or there is no session.
    pub fn send_bytes(&mut self, bytes: &[u8]) -> Result<u32, Refused> {
        self.middle.command(N::PLACE, bytes)
    }
}

fn known<V>(reading: Reading<'_>, decode: impl Fn(&[u8]) -> Option<V>) -> Option<Known<V>> {
    Some(Known {
        value: decode(reading.value)?,
        at: reading.at,
        stamp: reading.stamp,
    })
}
