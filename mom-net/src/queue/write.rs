//! From a batch to the link.

use std::collections::VecDeque;

use mom_proto::codec::Form;

use super::{Item, Piece};
use crate::{Flow, GATHER, NetError, Writer};

/// Writes a batch in this form from its front; false if the link takes no more now. `left` is told of each piece that has left.
///
/// # Errors
/// A link that failed.
pub fn write_batch<I: Item>(
    writer: &Writer,
    form: Option<Form>,
    flow: &mut Flow,
    batch: &mut VecDeque<Piece<I>>,
    mut left: impl FnMut(&Piece<I>),
) -> Result<bool, NetError> {
    if form.is_none() {
        return pass(writer, batch, left);
    }
    while let Some(front) = batch.front() {
        if !front.is_begun() {
            writer.at_boundary()?;
        }
        let mut slices = Vec::with_capacity(GATHER.min(batch.len() * 2 + 1));
        for piece in batch.iter() {
            if slices.len() + 3 > GATHER {
                break;
            }
            piece.append_to(form, &mut slices);
        }
        let Some(mut written) = writer.try_write_pieces(&slices)? else {
            return Ok(false);
        };
        drop(slices);
        flow.wrote(written);
        while let Some(front) = batch.front_mut() {
            written = front.advance(written);
            if front.left() > 0 {
                break;
            }
            left(front);
            batch.pop_front();
        }
    }
    Ok(true)
}

/// Passes parcels to a peer in this process.
fn pass<I: Item>(
    writer: &Writer,
    batch: &mut VecDeque<Piece<I>>,
    mut left: impl FnMut(&Piece<I>),
) -> Result<bool, NetError> {
    while let Some(front) = batch.front() {
        if let Some(parcel) = front.item().and_then(|item| item.parcel())
            && !writer.try_pass(parcel)?
        {
            return Ok(false);
        }
        left(front);
        batch.pop_front();
    }
    Ok(true)
}
