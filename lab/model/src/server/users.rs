//! Writes by another peer of the owner's user: one person may have several programs.

use std::collections::BTreeMap;

use mom_client::{Code, Parcel, Time, WireError};
use mom_program::others::{MOST_WAITING, are_one};

use super::write::name_of;
use super::{ModelServer, WRITE_REFUSED};

impl ModelServer {
    /// Whether the hub is to be asked who its peers are: the members of the tokens and of the model's channel, with
    /// their users. The answer is for [`ModelServer::handle_users`], which has to follow.
    pub fn ask_users(&mut self) -> bool {
        self.foreign.ask()
    }

    /// Takes the users of peers, by the peers' names; none where the hub could not be asked. Those of an owner's user
    /// write as the owner does.
    pub fn handle_users(&mut self, users: &BTreeMap<String, String>, now: Time, out: &mut Vec<Parcel>) {
        for parcel in self.foreign.take() {
            let sender = parcel.sender.as_deref().unwrap_or_default();
            let mut owners = self.owners_for(&parcel).into_iter();
            let owner = owners.find(|owner| are_one(users, owner, sender));
            let written = self.write(&parcel, owner.as_deref().unwrap_or(sender), now);
            out.push(self.answer(&parcel, written, WRITE_REFUSED));
        }
        self.tell(now, out);
    }

    /// Takes a write, and keeps it where it is not known yet whose it is.
    pub(super) fn take_write(&mut self, parcel: &Parcel, now: Time, out: &mut Vec<Parcel>) {
        if self.keep_foreign(parcel, out) {
            return;
        }
        let sender = parcel.sender.as_deref().unwrap_or_default();
        let written = self.write(parcel, sender, now);
        out.push(self.answer(parcel, written, WRITE_REFUSED));
        self.tell(now, out);
    }

    /// Keeps a write whose sender may be an owner's user under another name; whether it does.
    fn keep_foreign(&mut self, parcel: &Parcel, out: &mut Vec<Parcel>) -> bool {
        let owners = self.owners_for(parcel);
        if owners.is_empty() || owners.iter().any(|owner| parcel.sender.as_deref() == Some(owner)) {
            return false;
        }
        if self.foreign.keep(parcel) {
            return true;
        }
        let text = format!("{MOST_WAITING} writes are already queued; retry later");
        let error = WireError::new(Code::TRY_LATER, text);
        out.push(self.answer(parcel, Err(error), WRITE_REFUSED));
        true
    }

    /// The peers that own a token of the object that is to be written.
    fn owners_for(&self, parcel: &Parcel) -> Vec<String> {
        let content = parcel.value();
        // What is wrong with it, the writing says.
        let tokens = name_of(&content).map(|name| self.tokens_of(name));
        let tokens = tokens.unwrap_or_default();
        self.owners.of(&tokens).map(str::to_owned).collect()
    }
}
