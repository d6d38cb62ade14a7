/**
 * Agents for hire: an agent waits in a channel of its own, is asked for a task there, is lent the token for it, works, and gives it back.
 * {@link serve} is where to begin.
 *
 * @packageDocumentation
 */
export { type Agent, OFFERED, Refused, serve } from "./serve.js";
export { Task } from "./task.js";
