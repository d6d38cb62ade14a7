//! Making contexts: by request (M24) and from the configuration (M25).

use std::collections::BTreeMap;
use std::sync::Arc;

use mom_managers::{Manager, Terms};
use mom_proto::event;
use mom_proto::nearest::nearest;
use mom_proto::{Code, Content, ContextKind, ContextNumber, Fence, Path, Value, Verb, WireError};

use crate::asking::wish::Wish;
use crate::content::{bad, micros, path as read_path};
use crate::token::state::{SafeState, Token};
use crate::tree::context::{Channel, Context, GuardSpec, Presence, Role};
use crate::tree::spec::Devices;
use crate::world::{Timer, World};
use crate::{ContextSpec, Effect, KeepArgs, PeerId};

/// Channels that one token may guard: each renewal gives new routes to all of them.
const GUARDED: usize = 256;

/// Bytes of the managers that one user wrote for contexts, all together.
const MANAGING: usize = 4 << 20;

/// In a session of more members nobody is told what is made and deleted in it.
const ASKED: usize = 256;

/// What is wrong with the contexts of a configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct SetupError {
    /// The entry at fault, counted from 0; none for the root's manager.
    pub entry: Option<usize>,
    /// What is wrong, with the key as slot.
    pub error: WireError,
}

impl World {
    /// Makes a context of the configuration, which stays for good.
    pub(crate) fn make_configured(&mut self, spec: &ContextSpec) -> Result<ContextNumber, WireError> {
        let Some(path) = &spec.path else {
            return Err(bad(
                "path",
                "a context in the configuration must have a path".to_owned(),
            ));
        };
        self.make(read_path(path, "path")?, spec, None)
    }

    /// Makes a context below an existing session; checks everything before anything changes.
    pub(crate) fn make(
        &mut self,
        path: Path,
        spec: &ContextSpec,
        creator: Option<PeerId>,
    ) -> Result<ContextNumber, WireError> {
        let parent = self.tree.parent_for(&path)?;
        if self.tree.find(&path).is_some() {
            return Err(
                WireError::new(Code::EXISTS, format!("there is a context {path} already")).slot("context"),
            );
        }
        let user = creator.and_then(|creator| self.peers.get(creator));
        let user = user.map(|peer| Arc::clone(&peer.facts.user));
        let managing = spec
            .manager
            .as_ref()
            .map_or(0, |manager| Content::from(manager.clone()).size());
        if let Some(user) = &user {
            self.check_made(user, managing)?;
        }
        if !self.settings.limits.contexts.allows(self.tree.len() + 1) {
            let text = format!("the hub holds {} contexts, its limit", self.tree.len());
            return Err(WireError::new(Code::FULL, text));
        }
        self.check_path(&path)?;
        let manager = spec
            .manager
            .as_ref()
            .map(|spec| self.registry.build(spec).map_err(in_manager))
            .transpose()?;
        let managed_terms = match &manager {
            Some(manager) => manager.terms(),
            None => self.terms_above(parent),
        };
        let mut role = self.make_role(spec, managed_terms)?;
        self.check_guarded(&role)?;
        if let Role::Token(token) = &mut role {
            self.restore(&path, token);
        }
        let pace = spec.pace()?;
        let number = self.tree.next_number();
        self.tree.insert(Context {
            number,
            path,
            parent: Some(parent),
            children: BTreeMap::new(),
            members: BTreeMap::new(),
            manager,
            manager_word: spec.manager.as_ref().map(manager_word),
            manager_spec: spec.manager.clone(),
            creator,
            made_by: user,
            managing,
            invited: BTreeMap::new(),
            expelled: BTreeMap::new(),
            presence: spec.presence.unwrap_or_default(),
            pace,
            next_count: 0,
            count_due: false,
            transient: spec.transient,
            // Of the configuration, which nobody made and nobody deletes.
            permanent: creator.is_none(),
            permanent_below: 0,
            lifted: None,
            role,
        });
        self.link_guards(number);
        if let Some(until) = self
            .token(number)
            .and_then(|token| token.reserved.as_ref())
            .map(|kept| kept.until)
        {
            self.timers.insert((until, Timer::Reserved(number)));
        }
        Ok(number)
    }

    /// Checks that a user may make one more context, with so many bytes of manager.
    fn check_made(&self, user: &str, managing: usize) -> Result<(), WireError> {
        let made = self.tree.made_by(user);
        let most = self.settings.limits.user_contexts;
        if !most.allows(made.contexts + 1) {
            let text =
                format!("{user} has created {most} contexts, the limit for one user; delete some first");
            return Err(WireError::new(Code::FULL, text).rule("user-contexts"));
        }
        if managing > 0 && made.managing + managing > MANAGING {
            let text = format!(
                "the managers of {user}'s contexts take {} bytes, more than the limit of {MANAGING}; \
                 name a manager of the configuration, or delete some",
                made.managing
            );
            return Err(WireError::new(Code::FULL, text).slot("content/manager"));
        }
        Ok(())
    }

    /// Lets a new channel's token know what it guards, and a new token the channels that wait for one at
    /// its path since it was deleted there.
    pub(crate) fn link_guards(&mut self, number: ContextNumber) {
        let Some(made) = self.tree.get(number) else {
            return self.fault("setting a guard on or by a context that does not exist");
        };
        let (token, guarded): (Option<ContextNumber>, Vec<ContextNumber>) = match &made.role {
            Role::Session => return,
            Role::Channel(channel) => {
                let Some(guard) = channel.guard.as_ref().map(|guard| guard.token.clone()) else {
                    return;
                };
                let token = self.tree.token_at(&guard).map(|(number, _)| number);
                self.tree.add_guard(guard, number);
                (token, vec![number])
            }
            Role::Token(_) => {
                let waiting: Vec<ContextNumber> = self.tree.guarded_by(&made.path).collect();
                // Their routes show this token's fence from now on.
                self.changed.extend(&waiting);
                (Some(number), waiting)
            }
        };
        // The token of a channel may have been deleted.
        if let Some(token) = token.and_then(|token| self.token_mut(token)) {
            token.guarded.extend(guarded);
        }
    }

    /// Checks a path against the limits of this hub, which may be narrower than those of the wire.
    fn check_path(&self, path: &Path) -> Result<(), WireError> {
        let limits = &self.settings.limits;
        if path.as_str().len() > limits.path || path.segments().count() > limits.path_levels {
            let text = format!(
                "a path here has at most {} bytes and {} levels",
                limits.path, limits.path_levels
            );
            return Err(WireError::new(Code::BAD_PATH, text).slot("context"));
        }
        Ok(())
    }

    /// The terms of tokens whose manager is that of this session, or of the nearest one above.
    pub(crate) fn terms_above(&self, parent: ContextNumber) -> Terms {
        let managing = self.tree.managing(parent);
        managing
            .and_then(|context| context.manager.as_ref())
            .map(|manager| manager.terms())
            .unwrap_or_default()
    }

    /// The role of a context by its specification.
    pub(crate) fn make_role(&self, spec: &ContextSpec, terms: Terms) -> Result<Role, WireError> {
        let kind = ContextKind::from_word(&spec.kind).ok_or_else(|| {
            let near = nearest(&spec.kind, ContextKind::ALL.map(ContextKind::word));
            bad(
                "kind",
                format!("{:?} is not one of session, channel, token", spec.kind),
            )
            .nearest_opt(near)
        })?;
        let only = |present: bool, key: &str, of: ContextKind| match present && kind != of {
            true => Err(bad(key, format!("only a {of} has {key}"))),
            false => Ok(()),
        };
        only(spec.guard.is_some(), "guard", ContextKind::Channel)?;
        only(spec.delivery.is_some(), "delivery", ContextKind::Channel)?;
        only(spec.overflow.is_some(), "overflow", ContextKind::Channel)?;
        only(spec.pace.is_some(), "pace", ContextKind::Channel)?;
        only(spec.devices.is_some(), "devices", ContextKind::Channel)?;
        only(spec.keep.is_some(), "keep", ContextKind::Channel)?;
        only(spec.safe.is_some(), "safe", ContextKind::Token)?;
        only(spec.lease.is_some(), "lease", ContextKind::Token)?;
        only(spec.expiry.is_some(), "expiry", ContextKind::Token)?;
        only(spec.deadman.is_some(), "deadman", ContextKind::Token)?;
        only(spec.safe_on_give.is_some(), "safe-on-give", ContextKind::Token)?;
        only(
            spec.stop_ends_grant.is_some(),
            "stop-ends-grant",
            ContextKind::Token,
        )?;
        match kind {
            ContextKind::Session => Ok(Role::Session),
            ContextKind::Channel => Ok(Role::Channel(Channel {
                guard: self.make_guard(spec)?,
                delivery: spec.delivery()?,
                overflow: spec.overflow()?,
                keep: spec.keep.map(KeepArgs::read).transpose()?,
                several: spec.devices.map(|devices| devices == Devices::Several),
            })),
            ContextKind::Token => make_token(spec, terms).map(|token| Role::Token(Box::new(token))),
        }
    }

    fn make_guard(&self, spec: &ContextSpec) -> Result<Option<GuardSpec>, WireError> {
        let Some(guard) = &spec.guard else {
            return Ok(None);
        };
        let token = read_path(&guard.token, "guard/token")?;
        if self.tree.token_at(&token).is_none() {
            return Err(self
                .tree
                .unknown_path(&token, Some(ContextKind::Token))
                .slot("content/guard/token"));
        }
        if guard.names.is_empty() {
            return Err(bad(
                "guard/names",
                "a guard needs the names of messages, or *".to_owned(),
            ));
        }
        Ok(Some(GuardSpec {
            token,
            lost_fence: Fence::default(),
            names: Arc::from(guard.names.as_slice()),
        }))
    }

    /// Checks that a token may guard one channel more.
    fn check_guarded(&self, role: &Role) -> Result<(), WireError> {
        let Role::Channel(Channel {
            guard: Some(guard), ..
        }) = role
        else {
            return Ok(());
        };
        let token = self.tree.token_at(&guard.token);
        if token.is_some_and(|(_, token)| token.guarded.len() >= GUARDED) {
            let text = format!("{} guards {GUARDED} channels, the limit", guard.token);
            return Err(WireError::new(Code::FULL, text).slot("content/guard/token"));
        }
        Ok(())
    }

    /// Tells those members of a session about a new child who may look it up.
    pub(crate) fn push_created(&mut self, number: ContextNumber, by: Option<PeerId>, out: &mut Vec<Effect>) {
        let context = self.tree.get(number);
        let parent = context.and_then(|context| self.tree.get(context.parent?));
        let (Some(context), Some(parent)) = (context, parent) else {
            return self.fault("reporting the creation of a context that does not exist");
        };
        let mut content = context.summary();
        if let Some(by) = by {
            content.set("by", self.name_of(by));
        }
        let (path, parent) = (parent.path.clone(), parent.number);
        let to = self.who_may_know(number, parent);
        self.push_event(event::CREATED, &path, to, content, out);
        self.stop_made(number, out);
    }

    /// The members of a session who may look up a child. Of many none: each is a question to a manager, and they can list.
    pub(crate) fn who_may_know(&mut self, child: ContextNumber, session: ContextNumber) -> Vec<PeerId> {
        let Some(members) = self.tree.get(session).map(|session| &session.members) else {
            return Vec::new();
        };
        if members.len() > ASKED {
            return Vec::new();
        }
        let mut members: Vec<PeerId> = members.keys().copied().collect();
        members.retain(|member| self.ask(*member, &Wish::new(Verb::Lookup, child), &[]).is_ok());
        members
    }
}

/// The root: a session that is always there, whose members are not told of each other.
pub(crate) fn make_root(number: ContextNumber, manager: Box<dyn Manager>, word: String) -> Context {
    Context {
        number,
        path: Path::root(),
        parent: None,
        children: BTreeMap::new(),
        members: BTreeMap::new(),
        manager: Some(manager),
        manager_word: Some(word),
        manager_spec: None,
        creator: None,
        made_by: None,
        managing: 0,
        invited: BTreeMap::new(),
        expelled: BTreeMap::new(),
        presence: Presence::None,
        pace: None,
        next_count: 0,
        count_due: false,
        transient: false,
        permanent: true,
        permanent_below: 0,
        lifted: None,
        role: Role::Session,
    }
}

/// How a manager was named, for people.
pub(crate) fn manager_word(spec: &Value) -> String {
    match spec.as_str().or_else(|| spec.get("kind")?.as_str()) {
        Some(word) => word.to_owned(),
        None => "unnamed".to_owned(),
    }
}

fn make_token(spec: &ContextSpec, terms: Terms) -> Result<Token, WireError> {
    let lease = match spec.lease {
        None => terms.lease,
        Some(millis) => Some(micros(millis, "lease")?),
    };
    let safe = match &spec.safe {
        None => None,
        Some(safe) => {
            safe.check_name()?;
            let channel = read_path(&safe.channel, "safe/channel")?;
            let content = safe.content.clone().map(Content::Value);
            Some(SafeState {
                channel,
                name: safe.name.clone(),
                content,
            })
        }
    };
    let deadman = match spec.deadman {
        None => terms.deadman,
        Some(millis) => Some(micros(millis, "deadman")?),
    };
    Ok(Token {
        terms: Terms {
            lease,
            expiry: spec.expiry.unwrap_or(terms.expiry),
            deadman,
            ..terms
        },
        safe,
        safe_on_give: spec.safe_on_give.unwrap_or(true),
        stop_ends_grant: spec.stop_ends_grant.unwrap_or(false),
        ..Token::default()
    })
}

fn in_manager(error: WireError) -> WireError {
    let inner = error
        .get("slot")
        .and_then(Value::as_str)
        .map(|slot| format!("/{slot}"))
        .unwrap_or_default();
    error.slot(&format!("content/manager{inner}"))
}
