/*
 * CUBO as a robot in C, over UDP on a POSIX system: `cubo ADDRESS PORT [KEY]`. It says where it listens. Its body is simulated: wheels that
 * obey at once, 170 mm apart, and joints that are where they are told to be.
 */
#define _POSIX_C_SOURCE 200809L
#include <arpa/inet.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "mom_rsp.h"
#include "cubo.h"

/* ---- The body ---- */

struct body {
    struct cubo_robot *robot;
    double left, right;    /* mm/s */
    double x, y, heading;  /* mm, mm, rad */
    uint64_t at;           /* µs */
};

static void fill_random(void *self, uint8_t *bytes, size_t size)
{
    (void)self;
    int from = open("/dev/urandom", O_RDONLY);
    if (from < 0 || read(from, bytes, size) != (ssize_t)size)
        abort(); /* a session that can be foreseen is none */
    close(from);
}

static void set_left_wheel(void *self, double mm_per_s)
{
    ((struct body *)self)->left = mm_per_s;
}

static void set_right_wheel(void *self, double mm_per_s)
{
    ((struct body *)self)->right = mm_per_s;
}

static void set_joints(void *self, const double degrees[3])
{
    cubo_tell_posture(((struct body *)self)->robot, degrees);
}

static void run_gesture(void *self, double number)
{
    (void)self;
    printf("gesture %.0f\n", number);
}

static void session(void *self, bool up)
{
    (void)self;
    printf("%s\n", up ? "a session began" : "the session is over");
}

static const struct cubo_program PROGRAM = {
    .random = fill_random,
    .set_left_wheel = set_left_wheel,
    .set_right_wheel = set_right_wheel,
    .set_joints = set_joints,
    .run_gesture = run_gesture,
    .session = session
};

/* Lets time pass, and tells where it is. */
static void drive(struct body *body, uint64_t now)
{
    const double degrees = 180.0 / 3.14159265358979323846;
    double seconds = (double)(now - body->at) / 1e6;
    double way = (body->left + body->right) / 2 * seconds;
    body->heading = remainder(body->heading + (body->right - body->left) / 170 * seconds, 360 / degrees);
    body->x += way * cos(body->heading);
    body->y += way * sin(body->heading);
    body->at = now;
    const double pose[3] = { body->x, body->y, body->heading * degrees };
    const double surroundings[6] = { 2000, 300, 40, 0, 293, 100 };
    cubo_tell_pose(body->robot, pose);
    cubo_tell_surroundings(body->robot, surroundings);
}

/* ---- The program ---- */

static uint64_t clock_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000 + (uint64_t)now.tv_nsec / 1000;
}

/* A socket of this address, and where it listens. */
static int listen_at(const char *address, const char *port)
{
    struct sockaddr_in here = { .sin_family = AF_INET };
    socklen_t size = sizeof here;
    int to = socket(AF_INET, SOCK_DGRAM, 0);
    here.sin_port = htons((uint16_t)atoi(port));
    if (to < 0 || inet_pton(AF_INET, address, &here.sin_addr) != 1 || bind(to, (struct sockaddr *)&here, size) != 0) {
        fprintf(stderr, "cannot listen on %s:%s\n", address, port);
        exit(1);
    }
    getsockname(to, (struct sockaddr *)&here, &size);
    printf("listens on %s:%u\n", address, (unsigned)ntohs(here.sin_port));
    return to;
}

static void read_key(const char *digits, uint8_t key[32])
{
    for (size_t i = 0; i < 32; i++) {
        unsigned byte;
        if (sscanf(digits + 2 * i, "%2x", &byte) != 1) {
            fprintf(stderr, "a key has 64 hexadecimal digits\n");
            exit(1);
        }
        key[i] = (uint8_t)byte;
    }
}

/* Begin of the robot */
static void serve(int socket, struct body *body, struct cubo_robot *robot)
{
    static uint8_t in[CUBO_PACKET], out[CUBO_PACKET];
    struct sockaddr_in from, middle = { 0 }, asker = { 0 };
    for (;;) {
        size_t size;
        drive(body, clock_us());
        while ((size = mom_rsp_poll(&robot->end, clock_us(), out, sizeof out)) > 0) {
            const struct sockaddr_in *to = mom_rsp_is_refusal(out, size) ? &asker : &middle;
            sendto(socket, out, size, 0, (const struct sockaddr *)to, sizeof *to);
        }
        uint64_t now = clock_us(), wake = mom_rsp_wake(&robot->end);
        int wait = wake <= now ? 0 : wake - now > 500000 ? 500 : (int)((wake - now + 999) / 1000);
        if (poll(&(struct pollfd){ .fd = socket, .events = POLLIN }, 1, wait) <= 0)
            continue;
        socklen_t length = sizeof from;
        ssize_t heard = recvfrom(socket, in, sizeof in, 0, (struct sockaddr *)&from, &length);
        if (heard < 0 || from.sin_port == 0)
            continue;
        enum mom_rsp_outcome outcome = mom_rsp_receive(&robot->end, clock_us(), in, (size_t)heard);
        if (outcome == MOM_RSP_ACCEPTED)
            middle = from;
        else if (mom_rsp_refuses(outcome))
            asker = from;
    }
}
/* End of the robot */

int main(int count, char **words)
{
    static struct cubo_robot robot;
    struct body body = { .robot = &robot, .x = 2500, .y = 2500, .at = clock_us() };
    uint8_t key[32];
    if (count < 3) {
        fprintf(stderr, "cubo ADDRESS PORT [KEY]\n");
        return 2;
    }
    if (count > 3)
        read_key(words[3], key);
    struct mom_rsp_settings settings = { count > 3 ? key : NULL, &mom_rsp_portable_cipher, CUBO_WATCHDOG_MS, 1000 };
    setvbuf(stdout, NULL, _IOLBF, 0);
    if (cubo_init(&robot, &settings, &PROGRAM, &body) != MOM_RSP_FINE)
        return 1;
    serve(listen_at(words[1], words[2]), &body, &robot);
}
