/* Pseudo-terminal, socket, bad line: see line.h. */
#define _XOPEN_SOURCE 600
#include "line.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define QUEUE 65536u
#define FRAME 2048u
#define WAIT_MS 2000 /* a host that has waited for so long is sent away */

struct waiting {
    int fd, fresh;
    int64_t since_ms;
};

static struct {
    int fd, listener, terminal;  /* the host's bytes; who waits for one; our own end of the terminal */
    int fresh, muted;
    struct line_faults faults;
    size_t queued, held, ready;
    uint8_t queue[QUEUE];        /* to the host */
    uint8_t frame[FRAME];        /* from the host, up to its zero */
    uint8_t passed[4 * FRAME];   /* frames as the line lets them through */
    struct waiting waiting[LINE_WAITING];
} line = {.fd = -1, .listener = -1, .terminal = -1, .waiting = {{.fd = -1}, {.fd = -1}, {.fd = -1}, {.fd = -1}}};

static int64_t clock_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static int not_blocking(int fd)
{
    return fcntl(fd, F_SETFL, fcntl(fd, F_GETFL) | O_NONBLOCK);
}

/* Bytes as they are, no echo. */
static int raw(int fd)
{
    struct termios t;
    if (tcgetattr(fd, &t))
        return -1;
    t.c_iflag &= ~(tcflag_t)(IGNBRK | BRKINT | PARMRK | ISTRIP | INLCR | IGNCR | ICRNL | IXON);
    t.c_oflag &= ~(tcflag_t)OPOST;
    t.c_lflag &= ~(tcflag_t)(ECHO | ECHONL | ICANON | ISIG | IEXTEN);
    t.c_cflag = (t.c_cflag & ~(tcflag_t)(CSIZE | PARENB)) | CS8;
    t.c_cc[VMIN] = 1;
    t.c_cc[VTIME] = 0;
    return tcsetattr(fd, TCSANOW, &t);
}

int line_open_terminal(char *name, size_t room)
{
    const char *path;

    line.fd = posix_openpt(O_RDWR | O_NOCTTY);
    if (line.fd < 0 || grantpt(line.fd) || unlockpt(line.fd) || !(path = ptsname(line.fd)))
        return -1;
    line.terminal = open(path, O_RDWR | O_NOCTTY); /* held open: the line stays when a host leaves */
    if (line.terminal < 0 || raw(line.terminal))
        return -1;
    snprintf(name, room, "%s", path);
    return not_blocking(line.fd);
}

int line_open_tcp(uint16_t port, char *name, size_t room)
{
    struct sockaddr_in at;
    socklen_t size = sizeof at;
    const int yes = 1;

    signal(SIGPIPE, SIG_IGN);
    memset(&at, 0, sizeof at);
    at.sin_family = AF_INET;
    at.sin_addr.s_addr = htonl(INADDR_LOOPBACK); /* nobody else's machine reaches this one */
    at.sin_port = htons(port);
    line.listener = socket(AF_INET, SOCK_STREAM, 0);
    if (line.listener < 0 || setsockopt(line.listener, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes))
        return -1;
    if (bind(line.listener, (struct sockaddr *)&at, size) || listen(line.listener, 4))
        return -1;
    if (getsockname(line.listener, (struct sockaddr *)&at, &size))
        return -1;
    snprintf(name, room, "tcp://127.0.0.1:%u", (unsigned)ntohs(at.sin_port));
    return not_blocking(line.listener);
}

void line_set_faults(struct line_faults faults)
{
    line.faults = faults;
    line.faults.seed = faults.seed * UINT64_C(0x9e3779b97f4a7c15) + 1;
}

void line_mute(void)
{
    line.muted = 1;
}

/* 0 to 1, by xorshift (Marsaglia 2003). */
static double drawn(void)
{
    uint64_t *x = &line.faults.seed;
    *x ^= *x << 13;
    *x ^= *x >> 7;
    *x ^= *x << 17;
    return (double)(*x >> 11) / 9007199254740992.0;
}

/* A frame with its zero through the line: once, twice, changed, or not at all. */
static size_t through(const uint8_t *frame, size_t count, uint8_t *out)
{
    size_t made = 0;
    const int copies = (drawn() >= line.faults.drop) + (drawn() < line.faults.duplicate);

    for (int k = 0; k < copies; k++) {
        memcpy(out + made, frame, count);
        if (drawn() < line.faults.corrupt)
            out[made + (size_t)(drawn() * (double)count)] ^= (uint8_t)(1u << (int)(drawn() * 8.0));
        made += count;
    }
    return made;
}

size_t line_space(void)
{
    return line.muted || (line.fd < 0 && line.listener >= 0) ? QUEUE : QUEUE - line.queued > FRAME ? (QUEUE - line.queued) / 2 : 0;
}

void line_send(const uint8_t *frame, size_t count)
{
    if (line.muted || line.fd < 0 || count > line_space())
        return;
    line.queued += through(frame, count, line.queue + line.queued);
}

static void hang_up(void)
{
    if (line.listener < 0)
        return; /* a terminal stays */
    close(line.fd);
    line.fd = -1;
    line.queued = line.held = line.ready = 0;
}

void line_flush(void)
{
    while (line.fd >= 0 && line.queued > 0) {
        const ssize_t sent = write(line.fd, line.queue, line.queued);
        if (sent > 0) {
            memmove(line.queue, line.queue + sent, line.queued - (size_t)sent);
            line.queued -= (size_t)sent;
        } else {
            if (errno != EAGAIN && errno != EINTR)
                hang_up();
            return;
        }
    }
}

static void send_away(struct waiting *one)
{
    close(one->fd);
    one->fd = -1;
}

/* The place of the host that has waited longest, or NULL where nobody waits; `free`: a place where nobody waits, if any. */
static struct waiting *longest_waiting(struct waiting **free)
{
    struct waiting *out = NULL;
    for (struct waiting *one = line.waiting; one < line.waiting + LINE_WAITING; one++)
        if (one->fd < 0)
            *free = one;
        else if (!out || one->since_ms < out->since_ms)
            out = one;
    return out;
}

/* One host at a time: another one waits. */
static void greet(void)
{
    const int yes = 1, fd = accept(line.listener, NULL, NULL);
    struct waiting *place = NULL, *oldest = longest_waiting(&place);

    if (fd < 0)
        return;
    if (not_blocking(fd)) {
        close(fd);
        return;
    }
    (void)setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    if (!place) {
        send_away(oldest);
        place = oldest;
    }
    *place = (struct waiting){fd, 1, clock_ms()};
}

void line_give_place(int idle)
{
    struct waiting *unused = NULL, *next = longest_waiting(&unused);

    if (!next)
        return;
    if (line.fd >= 0 && idle)
        hang_up();
    if (line.fd < 0) {
        line.fd = next->fd;
        line.fresh = 1;
        next->fd = -1;
    } else if (clock_ms() - next->since_ms >= WAIT_MS) {
        send_away(next);
    }
}

size_t line_overhear(int k, uint8_t *bytes, size_t room, int *fresh)
{
    struct waiting *one = &line.waiting[k];
    *fresh = one->fresh;
    one->fresh = 0;
    if (one->fd < 0)
        return 0;
    const ssize_t count = read(one->fd, bytes, room);
    if (count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR))
        send_away(one);
    return count > 0 ? (size_t)count : 0;
}

int line_waited_ms(int k)
{
    return (int)(clock_ms() - line.waiting[k].since_ms);
}

void line_answer(int k, const uint8_t *frame, size_t count)
{
    if (!line.muted && line.waiting[k].fd >= 0 && write(line.waiting[k].fd, frame, count) < 0)
        send_away(&line.waiting[k]); /* a host that does not read its answers */
}

int line_wait(int ms, int until_eof)
{
    const short out = line.queued > 0 ? POLLIN | POLLOUT : POLLIN;
    struct pollfd all[3 + LINE_WAITING] = {{line.fd, out, 0}, {line.listener, POLLIN, 0}, {until_eof ? 0 : -1, POLLIN, 0}};
    char ignored[256];

    for (int k = 0; k < LINE_WAITING; k++)
        all[3 + k] = (struct pollfd){line.waiting[k].fd, POLLIN, 0};
    if (poll(all, 3 + LINE_WAITING, ms) <= 0)
        return 1;
    if (all[1].revents & POLLIN)
        greet();
    if (all[2].revents && read(0, ignored, sizeof ignored) <= 0)
        return 0;
    return 1;
}

/* Collect the host's bytes by frames, so that the line's faults hit frames. */
static void collect(const uint8_t *bytes, size_t count)
{
    for (size_t k = 0; k < count; k++) {
        line.frame[line.held++] = bytes[k];
        if (bytes[k] == 0 || line.held == FRAME) {
            line.ready += through(line.frame, line.held, line.passed + line.ready);
            line.held = 0;
        }
    }
}

size_t line_receive(uint8_t *bytes, size_t room, int *fresh)
{
    const size_t most = room < FRAME ? room / 2 : FRAME;
    uint8_t got[FRAME];

    *fresh = line.fresh;
    line.fresh = 0;
    line.ready = 0;
    if (line.fd < 0)
        return 0;
    const ssize_t count = read(line.fd, got, most);
    if (count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR))
        hang_up();
    if (count <= 0)
        return 0;
    collect(got, (size_t)count);
    memcpy(bytes, line.passed, line.ready);
    return line.ready;
}
