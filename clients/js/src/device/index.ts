/**
 * Devices: what obeys at a hub. {@link device} is where to begin.
 *
 * @packageDocumentation
 */
export { Device, Obeying, device } from "./peer.js";
export { runs } from "./program.js";
export type { Planned, Spec } from "./spec.js";
export { attachment, number, outOfReach, verb, whole, word } from "./declare.js";
export type { Act, Arg, Args, ArgTerms, ArgType, Call, ValuesOf, Verb } from "./declare.js";
export { sleep } from "./sleep.js";
export { DEVICE_CODES, DeviceError, type DeviceErrorName, type ErrorDetails } from "./errors.js";
export { Machine } from "./machine.js";
export type { DeviceAge } from "./pull.js";
export { DeviceServer, type DeviceEvent, type Gate, type ServerOptions } from "./server.js";
export { Attachments, Script, type Statement, Word, Words, readScript } from "./script.js";
export { type AtRest, Sample } from "./rest.js";
export type { Order, Progress, State } from "./commands.js";
