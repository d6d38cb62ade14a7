// The programs that `mom-device` has, by the names of their links, and what each is. All that needs their names includes this file.
[
    ("mom-arm", "the robot arm of the demonstration lab, a device of a hub"),
    ("mom-camera", "a camera of the lab, drawn or a real one by its URL"),
    ("mom-model", "the model server: where objects are, by what cameras see"),
    ("mom-servo", "the agent that puts one block beside another by camera images"),
    ("mom-mcp", "tools for language models, over the Model Context Protocol"),
    ("mom-linuxbot", "the robot server of the fleet, which a base station drives"),
    ("mom-base-station", "the base station of a fleet, in a terminal or from a script"),
    ("mom-gateway", "makes the robots of a fleet devices of a hub"),
    ("mom-rover", "a wheeled robot that is a device of a hub by itself"),
    ("mom-cubo", "a thin robot, which another computer thinks for over RSP"),
    ("mom-simulacrum", "the computer that thinks for thin robots, and makes them devices of a hub"),
]
