/* A wall clock that jumps, for the processes that preload this: `HALMA_FALSE_CLOCK` names a file of eight bytes, the
 * offset in seconds as a native signed integer, read at every look at the clock. Monotonic time stays true.
 *
 * Waits until a moment of the wall clock are translated back, as the kernel would do after a real jump: without it a
 * process would sleep for as long as the clock had jumped, which no real clock makes it do.
 *
 * Why not libfaketime: 0.9.10 refuses `clock_nanosleep` on the monotonic clock, which is what Python sleeps by.
 *
 *     cc -shared -fPIC -O2 -o false_clock.so false_clock.c -ldl -lpthread
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile int64_t *offset_seconds;

__attribute__((constructor)) static void look_up_the_file(void) {
    const char *path = getenv("HALMA_FALSE_CLOCK");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0)
        return;
    void *page = mmap(NULL, sizeof(int64_t), PROT_READ, MAP_SHARED, file, 0);
    close(file);
    if (page != MAP_FAILED)
        offset_seconds = page;
}

static int64_t offset(void) { return offset_seconds ? *offset_seconds : 0; }

static int is_wall(clockid_t clock) { return clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE; }

int clock_gettime(clockid_t clock, struct timespec *now) {
    int failed = (int)syscall(SYS_clock_gettime, clock, now);
    if (!failed && is_wall(clock))
        now->tv_sec += offset();
    return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    int failed = (int)syscall(SYS_gettimeofday, now, zone);
    if (!failed)
        now->tv_sec += offset();
    return failed;
}

time_t time(time_t *place) {
    struct timespec now;
    syscall(SYS_clock_gettime, CLOCK_REALTIME, &now);
    now.tv_sec += offset();
    if (place)
        *place = now.tv_sec;
    return now.tv_sec;
}

/* The same moment on the true clock. Monotonic moments (seconds since the start of the machine) are left alone. */
static struct timespec truly(const struct timespec *moment) {
    struct timespec true_moment = *moment;
    if (moment->tv_sec > 1000000000)
        true_moment.tv_sec -= offset();
    return true_moment;
}

#define REAL(name, version) \
    static __typeof__(name) *real; \
    if (!real) { \
        real = (__typeof__(name) *)dlvsym(RTLD_NEXT, #name, version); \
        if (!real) \
            real = (__typeof__(name) *)dlsym(RTLD_NEXT, #name); \
    }

int pthread_cond_timedwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
                           const struct timespec *restrict until) {
    REAL(pthread_cond_timedwait, "GLIBC_2.3.2")
    struct timespec moment = truly(until);
    return real(condition, mutex, &moment);
}

int pthread_cond_clockwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex, clockid_t clock,
                           const struct timespec *restrict until) {
    REAL(pthread_cond_clockwait, "GLIBC_2.34")
    struct timespec moment = truly(until);
    return real(condition, mutex, clock, &moment);
}

int pthread_mutex_timedlock(pthread_mutex_t *restrict mutex, const struct timespec *restrict until) {
    REAL(pthread_mutex_timedlock, "GLIBC_2.34")
    struct timespec moment = truly(until);
    return real(mutex, &moment);
}

int sem_timedwait(sem_t *restrict semaphore, const struct timespec *restrict until) {
    REAL(sem_timedwait, "GLIBC_2.34")
    struct timespec moment = truly(until);
    return real(semaphore, &moment);
}

int sem_clockwait(sem_t *restrict semaphore, clockid_t clock, const struct timespec *restrict until) {
    REAL(sem_clockwait, "GLIBC_2.34")
    struct timespec moment = truly(until);
    return real(semaphore, clock, &moment);
}

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *wanted, struct timespec *left) {
    REAL(clock_nanosleep, "GLIBC_2.17")
    if (!(flags & TIMER_ABSTIME))
        return real(clock, flags, wanted, left);
    struct timespec moment = truly(wanted);
    return real(clock, flags, &moment, left);
}
