/**
 * Driving: commands to a device, each followed to its end. {@link drive} is where to begin.
 *
 * @packageDocumentation
 */
export { Driving, drive } from "./driving.js";
export { Commander, type CarryOutOptions } from "./commander.js";
export { Course, type Command, type Progress, type Step } from "./course.js";
export { DriveError, commandEnd, lossWords, verdict, type CommandEnd, type Halt, type How, type Refusal, type Whose } from "./end.js";
export { reportOf, stateOf, type CommandReport, type StateNews } from "./heard.js";
