import { define } from "../../element.svelte.js";
import Login from "./Login.svelte";
import css from "./login.css?inline";

define("mom-login", Login, css);
