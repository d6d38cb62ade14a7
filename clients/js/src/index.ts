/**
 * A peer at a hub of MOM, in a page, a worker or Node. {@link connect} is where to begin.
 *
 * @packageDocumentation
 */
export { connect, Client, type ContextSpec, type Thinning } from "./contexts/client.js";
export { endPeer, type LinkCredential } from "./end.js";
export { Session, type Joined } from "./contexts/session.js";
export { Channel, type MessageOptions, type Receipt } from "./contexts/channel.js";
export { Token, TokenGuard, InhibitGuard, Given, type GrabOptions, type GiveOptions } from "./contexts/token.js";
export { Latch, type Held, type Turn } from "./latch.js";
export { isObeyed, type DeviceAnswer, type DeviceWord, type StopOptions, type StopReport, type StopState, type ToldChannel } from "./stops.js";
export type { Obeys } from "./contexts/obey.js";
export { Consult } from "./contexts/consult.js";
export { Key } from "./key.js";
export { MomError, type ErrorKind } from "./error.js";
export { report, type Report } from "./report.js";
export { Double, Time, fieldsOf, type Fields, type Value } from "./value.js";
export type { ConnectOptions, LinkState, Proof } from "./options.js";
export type { ContextInfo, ContextKind, Event, Events, GrabbedEvent, Member, MessageEvent, ReleasedEvent } from "./events.js";
export type { Delivery, Family, Parcel } from "./parcel.js";
export type { Loan, Lost } from "./guards.js";
export type { GuardState } from "./places.js";
export type { Age, HubClock } from "./clock.js";
export type { Queue } from "./queue.js";
export type { WebSocketClass, WebSocketLike } from "./pipe.js";
export { connectRaw, type RawConnection, type RawOptions } from "./raw.js";
export type { WireOptions } from "./wire.js";
