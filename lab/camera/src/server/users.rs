//! Changes of the settings by another peer of the owner's user: one person may have several programs.

use std::collections::BTreeMap;

use mom_client::{Code, Parcel, WireError};

use super::{ImageServer, SETTINGS_REFUSED, request_of};

/// The most changes that wait until it is known whose they are.
const MOST_CHANGES: usize = 16;
/// All guests are this one user to the hub, and yet not one person.
const GUEST: &str = "guest";

/// Changes of the settings by peers that do not own the token.
#[derive(Debug, Default)]
pub(super) struct ForeignChanges {
    /// Nobody has asked yet whose they are.
    new: Vec<Parcel>,
    /// The hub is being asked.
    asked: Vec<Parcel>,
}

impl ImageServer {
    /// Whether the hub is to be asked who its peers are: the members of the token and of the camera's channel, with
    /// their users. The answer is for [`ImageServer::handle_users`], which has to follow.
    pub fn ask_users(&mut self) -> bool {
        let changes = &mut self.changes;
        if changes.new.is_empty() || !changes.asked.is_empty() {
            return false;
        }
        changes.asked = std::mem::take(&mut changes.new);
        true
    }

    /// Takes the users of peers, by the peers' names; none where the hub could not be asked. Those of the owner's user
    /// change the settings as the owner does. The hub made both names, so that nobody can pretend to be another.
    pub fn handle_users(&mut self, users: &BTreeMap<String, String>, out: &mut Vec<Parcel>) {
        for parcel in std::mem::take(&mut self.changes.asked) {
            let owner = self.owner.name().and_then(|owner| users.get(owner));
            let sender = parcel.sender.as_deref().and_then(|sender| users.get(sender));
            let same = owner.is_some() && owner == sender && owner.is_none_or(|user| user != GUEST);
            let owner = match same {
                true => self.owner.name().map(str::to_owned),
                false => parcel.sender.as_deref().map(str::to_owned),
            };
            let answer = self.change_by(owner.as_deref(), &parcel);
            out.push(answer);
        }
    }

    /// Keeps a change whose sender may be the owner's user under another name; whether it does.
    pub(super) fn keep_foreign(&mut self, parcel: &Parcel, out: &mut Vec<Parcel>) -> bool {
        let foreign = self
            .owner
            .name()
            .is_some_and(|owner| parcel.sender.as_deref() != Some(owner));
        if !foreign {
            return false;
        }
        if self.changes.new.len() < MOST_CHANGES {
            self.changes.new.push(parcel.clone());
            return true;
        }
        let text = format!("{MOST_CHANGES} changes of the settings wait already; ask again in a moment");
        let error = WireError::new(Code::TRY_LATER, text);
        out.push(self.answer(SETTINGS_REFUSED, error.to_map(), &request_of(parcel)));
        true
    }
}
