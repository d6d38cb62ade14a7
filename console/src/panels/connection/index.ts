import { define } from "../../element.svelte.js";
import Connection from "./Connection.svelte";

define("mom-connection", Connection, "", ["address", "user", "password", "guest", "token"]);
