/* A robot: the state of its end, and the memory that this needs. */
struct NAME_robot {
    struct mom_rsp_robot end; /* for mom_rsp_receive, mom_rsp_poll and what else mom_rsp.h has */
    const struct NAME_program *program;
    void *self;
    struct mom_rsp_cell cells[PREFIX_ELEMENTS];
    uint8_t values[PREFIX_VALUES > 0 ? PREFIX_VALUES : 1];
    struct mom_rsp_buffer buffers[PREFIX_BUFFERS > 0 ? PREFIX_BUFFERS : 1];
    uint8_t held[PREFIX_BUFFERS * PREFIX_SLOT > 0 ? PREFIX_BUFFERS * PREFIX_SLOT : 1];
};

static inline void NAME_on_random(void *self, uint8_t *bytes, size_t size)
{
    const struct NAME_robot *robot = (const struct NAME_robot *)self;
    robot->program->random(robot->self, bytes, size);
}

static inline void NAME_on_fragment(void *self, const struct mom_rsp_fragment *fragment)
{
    const struct NAME_robot *robot = (const struct NAME_robot *)self;
    if (robot->program->fragment != NULL)
        robot->program->fragment(robot->self, fragment);
}

static inline bool NAME_on_next_fragment(void *self, struct mom_rsp_fragment *fragment, uint8_t *into)
{
    const struct NAME_robot *robot = (const struct NAME_robot *)self;
    return robot->program->next_fragment != NULL && robot->program->next_fragment(robot->self, fragment, into);
}

static inline void NAME_on_active(void *self, uint8_t element, bool active)
{
    const struct NAME_robot *robot = (const struct NAME_robot *)self;
    if (robot->program->active != NULL)
        robot->program->active(robot->self, element, active);
}

static inline void NAME_on_session(void *self, bool up)
{
    const struct NAME_robot *robot = (const struct NAME_robot *)self;
    if (robot->program->session != NULL)
        robot->program->session(robot->self, up);
}

static inline void NAME_on_unknown(void *self, uint8_t element)
{
    const struct NAME_robot *robot = (const struct NAME_robot *)self;
    if (robot->program->unknown != NULL)
        robot->program->unknown(robot->self, element);
}

static const struct mom_rsp_body NAME_body = {
    NAME_on_random, NAME_on_effector, NAME_on_command, NAME_on_fragment,
    NAME_on_next_fragment, NAME_on_active, NAME_on_session, NAME_on_unknown
};

/* A robot that has no session. Its program is not copied; `self` is what the program's functions get. */
static inline enum mom_rsp_fault NAME_init(struct NAME_robot *robot, const struct mom_rsp_settings *settings,
                                           const struct NAME_program *program, void *self)
{
    struct mom_rsp_memory memory;
    memory.cells = robot->cells;
    memory.cell_count = PREFIX_ELEMENTS;
    memory.values = robot->values;
    memory.value_size = PREFIX_VALUES;
    memory.buffers = robot->buffers;
    memory.buffer_count = PREFIX_BUFFERS;
    memory.held = robot->held;
    memory.held_size = PREFIX_BUFFERS * PREFIX_SLOT;
    robot->program = program;
    robot->self = self;
    if (program->random == NULL)
        return MOM_RSP_FAULT_BODY;
    return mom_rsp_init(&robot->end, &NAME_layout, settings, &memory, &NAME_body, robot);
}
