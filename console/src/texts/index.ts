// All texts of the console, in one place. Another language is another folder of the same shape.
import { access, whatIf } from "./access.js";
import { audit } from "./audit.js";
import { camera, cameras, cursor } from "./camera.js";
import { common } from "./common.js";
import { context, tree, watch } from "./contexts.js";
import { login, status, stop, token } from "./control.js";
import { calibrate, chat, commands, drive, jog, notices, objects } from "./driving.js";
import { figures } from "./figures.js";
import { health, peers } from "./hub.js";
import { shell } from "./shell.js";

export const texts = {
  access, audit, calibrate, camera, cameras, chat, commands, common, context, cursor, drive, figures, health, jog, login, notices, objects, peers, shell, status,
  stop, token, tree, watch, whatIf,
};
