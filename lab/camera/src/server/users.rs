//! Changes of the settings by another peer of the owner's user: one person may have several programs.

use std::collections::BTreeMap;

use mom_client::{Code, Parcel, WireError};
use mom_program::others::{MOST_WAITING, are_one};

use super::{ImageServer, SETTINGS_REFUSED, request_of};

impl ImageServer {
    /// Whether the hub is to be asked who its peers are: the members of the token and of the camera's channel, with
    /// their users. The answer is for [`ImageServer::handle_users`], which has to follow.
    pub fn ask_users(&mut self) -> bool {
        self.changes.ask()
    }

    /// Takes the users of peers, by the peers' names; none where the hub could not be asked. Those of the owner's user
    /// change the settings as the owner does.
    pub fn handle_users(&mut self, users: &BTreeMap<String, String>, out: &mut Vec<Parcel>) {
        for parcel in self.changes.take() {
            let sender = parcel.sender.as_deref();
            let owner = self.owner.name();
            let owner = owner.filter(|owner| sender.is_some_and(|sender| are_one(users, owner, sender)));
            let owner = owner.or(sender).map(str::to_owned);
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
        if self.changes.keep(parcel) {
            return true;
        }
        let text = format!("{MOST_WAITING} changes of the settings wait already; ask again in a moment");
        let error = WireError::new(Code::TRY_LATER, text);
        out.push(self.answer(SETTINGS_REFUSED, error.to_map(), &request_of(parcel)));
        true
    }
}
