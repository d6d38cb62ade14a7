//! Dialogues with the hub: what peers say, and what each of them hears.

mod again;
mod asked;
mod durable;
mod facts;
mod handed_back;
mod handover;
mod hidden;
mod identity;
mod inquiries;
mod judge;
mod large;
mod link;
mod made;
mod presence;
mod review;
mod safe_first;
mod sessions;
mod stage;
mod stats;
mod stops;
mod tell_pace;
mod terms;
mod thinning;
mod threat_19;
mod wall;
mod zones;
