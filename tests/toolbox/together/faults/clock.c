/* A clock that stands where CLOCK_AT says (s since 1970) and goes back by CLOCK_BACK (s) at every look; for LD_PRELOAD. */
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>

static long long now(void)
{
    static long long looks = 0;
    return atoll(getenv("CLOCK_AT")) - atoll(getenv("CLOCK_BACK")) * looks++;
}

time_t time(time_t *t)
{
    time_t at = (time_t)now();
    if (t) *t = at;
    return at;
}

int gettimeofday(struct timeval *restrict tv, void *restrict zone)
{
    (void)zone;
    tv->tv_sec = (time_t)now();
    tv->tv_usec = 0;
    return 0;
}

extern int __clock_gettime(clockid_t, struct timespec *);

int clock_gettime(clockid_t which, struct timespec *ts)
{
    if (which != CLOCK_REALTIME) return __clock_gettime(which, ts);
    ts->tv_sec = (time_t)now();
    ts->tv_nsec = 0;
    return 0;
}
