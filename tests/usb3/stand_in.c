/* A bus that is not there: the part of libusb that Aravis calls, over cameras in this process.

   Load it before Aravis, for everybody to see, and Aravis' own USB3 Vision code talks to it: a
   bulk transfer to a camera calls the camera's `answer`, and what a camera sends fills the
   transfers that wait for it, in order. Times are nobody's here; the cameras keep them.

   As on a real bus, what was opened before a camera left stays dead when the camera comes back:
   a departed device that is let go late must not speak with the one that was plugged in again.

   Aravis 0.8.26 looks at a count and then waits for it to change, without a lock between the two:
   a transfer that ends in between is waited for without end. So its stream threads are disturbed
   now and then by a signal, after which they look again. And its callbacks count a transfer as over
   before they lock the stream's mutex to tell so: a stream that closes then can clear the locked
   mutex, which ends the process. So a transfer is not freed before its callback has returned. */

#include <libusb-1.0/libusb.h>
#include <pthread.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

enum {
    MAX_CAMERAS = 16,
    MAX_LISTENERS = 4,
    MAX_REPLY_BYTES = 65536,
    MAX_WAIT_MS = 50,
    TEXT_BYTES = 64,
};

enum { DISTURB = SIGURG };

enum { CONTROL_OUT = 0x01, CONTROL_IN = 0x81, PICTURES_IN = 0x82 };

enum { MAKER = 1, MODEL, SERIAL, IDENTITY, TEXTS };

/* Obeys a command and writes the answer; returns its size. */
typedef int answer_fn(int camera, const uint8_t *command, int size, uint8_t *reply, int room);

/* A packet may come in two parts, so that pixels need not be copied to what follows them. */
struct data {
    const uint8_t *bytes, *tail;
    int size, tail_size, taken;
};

struct packet {
    struct packet *next;
    struct data data;
    uint8_t bytes[];
};

/* The context is kept here: the handle of a transfer may be closed before the transfer is over. */
struct waiting {
    struct waiting *next;
    struct libusb_transfer *transfer;
    const libusb_context *context;
    bool cancelled, filled, orphaned;
};

struct camera {
    bool known, plugged, forbidden;
    char texts[TEXTS][TEXT_BYTES];
    int departures;
    answer_fn *answer;
    struct packet *packets;
    struct waiting *waiting;
    libusb_device_handle *owner;
    const libusb_context *stream_context;
    pid_t stream_thread;
};

struct libusb_device {
    int camera;
    libusb_context *context;
};

struct libusb_device_handle {
    libusb_device *device;
    int departures;
    uint8_t reply[MAX_REPLY_BYTES];
    int reply_size;
};

/* A callback that is running; it lives on the stack of its thread. */
struct calling {
    struct calling *next;
    const struct libusb_transfer *transfer;
};

struct listener {
    libusb_hotplug_callback_fn called;
    void *user_data;
};

struct libusb_context {
    libusb_device devices[MAX_CAMERAS];
    int told_departures[MAX_CAMERAS];
    struct listener listeners[MAX_LISTENERS];
};

static struct camera cameras[MAX_CAMERAS];
static struct calling *callings;
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t changed = PTHREAD_COND_INITIALIZER;

static void wake_up(void)
{
    pthread_cond_broadcast(&changed);
    pthread_mutex_unlock(&lock);
}

static bool is_dead(const libusb_device_handle *handle)
{
    const struct camera *camera = &cameras[handle->device->camera];
    return !camera->plugged || camera->departures != handle->departures;
}

static void nothing(int signal_number)
{
    (void)signal_number;
}

__attribute__((constructor)) static void prepare(void)
{
    struct sigaction action = {.sa_handler = nothing};
    sigaction(DISTURB, &action, NULL);
}

/* What the cameras call. */

int stand_in_attach(const char *maker, const char *model, const char *serial, answer_fn *answer)
{
    pthread_mutex_lock(&lock);
    int number = 0;
    while (number < MAX_CAMERAS && cameras[number].known)
        number++;
    if (number < MAX_CAMERAS) {
        struct camera *camera = &cameras[number];
        *camera = (struct camera){.departures = camera->departures, .waiting = camera->waiting};
        strncpy(camera->texts[MAKER], maker, TEXT_BYTES - 1);
        strncpy(camera->texts[MODEL], model, TEXT_BYTES - 1);
        strncpy(camera->texts[SERIAL], serial, TEXT_BYTES - 1);
        strncpy(camera->texts[IDENTITY], serial, TEXT_BYTES - 1);
        camera->answer = answer;
        camera->known = camera->plugged = true;
    }
    wake_up();
    return number < MAX_CAMERAS ? number : -1;
}

static void drop_packets(struct camera *camera)
{
    while (camera->packets) {
        struct packet *first = camera->packets;
        camera->packets = first->next;
        free(first);
    }
}

void stand_in_plug(int number, int plugged)
{
    pthread_mutex_lock(&lock);
    struct camera *camera = &cameras[number];
    if (camera->plugged && !plugged) {
        camera->departures++;
        camera->owner = NULL;
        drop_packets(camera);
        for (struct waiting *each = camera->waiting; each; each = each->next)
            each->orphaned = true;
    }
    camera->plugged = plugged;
    wake_up();
}

void stand_in_forbid(int number, int forbidden)
{
    pthread_mutex_lock(&lock);
    cameras[number].forbidden = forbidden;
    wake_up();
}

void stand_in_detach(int number)
{
    stand_in_plug(number, 0);
    pthread_mutex_lock(&lock);
    cameras[number].known = false;
    wake_up();
}

static int left_of(const struct data *data)
{
    return data->size + data->tail_size - data->taken;
}

/* Take up to `room` bytes of a packet; returns how many. */
static int take(struct data *data, uint8_t *to, int room)
{
    int begin = data->taken;
    int end = begin + (room < left_of(data) ? room : left_of(data));
    int middle = end < data->size ? end : data->size;
    if (begin < middle)
        memcpy(to, data->bytes + begin, middle - begin);
    if (middle < end) {
        int from = begin > data->size ? begin : data->size;
        memcpy(to + (from - begin), data->tail + (from - data->size), end - from);
    }
    data->taken = end;
    return end - begin;
}

/* Keep what is left of a packet until somebody waits for it. */
static void keep(struct camera *camera, struct data *data)
{
    int size = left_of(data);
    struct packet *packet = malloc(sizeof *packet + size);
    take(data, packet->bytes, size);
    packet->next = NULL;
    packet->data = (struct data){.bytes = packet->bytes, .size = size};
    struct packet **end = &camera->packets;
    while (*end)
        end = &(*end)->next;
    *end = packet;
}

static void fill(struct waiting *waiting, struct data *data)
{
    struct libusb_transfer *transfer = waiting->transfer;
    transfer->actual_length = take(data, transfer->buffer, transfer->length);
    transfer->status = LIBUSB_TRANSFER_COMPLETED;
    waiting->filled = true;
}

/* Send one packet: into the transfers that wait, and the rest into the queue. */
void stand_in_send(int number, const uint8_t *bytes, int size, const uint8_t *tail, int tail_size)
{
    struct camera *camera = &cameras[number];
    struct data data = {bytes, tail, size, tail_size, 0};
    pthread_mutex_lock(&lock);
    struct waiting *next = camera->packets ? NULL : camera->waiting;
    for (; next && left_of(&data) > 0; next = next->next)
        if (!next->filled && !next->cancelled && !next->orphaned)
            fill(next, &data);
    if (left_of(&data) > 0)
        keep(camera, &data);
    wake_up();
}

int stand_in_unsent(int number)
{
    int count = 0;
    pthread_mutex_lock(&lock);
    for (struct packet *each = cameras[number].packets; each; each = each->next)
        count++;
    pthread_mutex_unlock(&lock);
    return count;
}

/* Tell how many transfers wait for the camera, are filled, are cut short. */
void stand_in_count(int number, int *waiting, int *filled, int *cut_short)
{
    *waiting = *filled = *cut_short = 0;
    pthread_mutex_lock(&lock);
    for (struct waiting *each = cameras[number].waiting; each; each = each->next) {
        *(each->cancelled || each->orphaned ? cut_short : each->filled ? filled : waiting) += 1;
    }
    pthread_mutex_unlock(&lock);
}

void stand_in_forget(int number)
{
    pthread_mutex_lock(&lock);
    drop_packets(&cameras[number]);
    pthread_mutex_unlock(&lock);
}

/* libusb: who is there. */

int libusb_init(libusb_context **made)
{
    libusb_context *context = calloc(1, sizeof *context);
    for (int number = 0; number < MAX_CAMERAS; number++) {
        context->devices[number] = (libusb_device){number, context};
        context->told_departures[number] = cameras[number].departures;
    }
    *made = context;
    return LIBUSB_SUCCESS;
}

void libusb_exit(libusb_context *context)
{
    free(context);
}

ssize_t libusb_get_device_list(libusb_context *context, libusb_device ***list)
{
    ssize_t count = 0;
    *list = calloc(MAX_CAMERAS + 1, sizeof **list);
    pthread_mutex_lock(&lock);
    for (int number = 0; number < MAX_CAMERAS; number++)
        if (cameras[number].known && cameras[number].plugged)
            (*list)[count++] = &context->devices[number];
    pthread_mutex_unlock(&lock);
    return count;
}

void libusb_free_device_list(libusb_device **list, int unref)
{
    (void)unref;
    free(list);
}

int libusb_get_device_descriptor(libusb_device *device, struct libusb_device_descriptor *descriptor)
{
    (void)device;
    *descriptor = (struct libusb_device_descriptor){
        .bLength = LIBUSB_DT_DEVICE_SIZE,
        .bDescriptorType = LIBUSB_DT_DEVICE,
        .bcdUSB = 0x0310,
        .bDeviceClass = LIBUSB_CLASS_MISCELLANEOUS,
        .bDeviceSubClass = 0x02,
        .bDeviceProtocol = 0x01,
        .bMaxPacketSize0 = 9,
        .idVendor = 0x1e10,
        .idProduct = 0x4000,
        .iManufacturer = MAKER,
        .iProduct = MODEL,
        .iSerialNumber = SERIAL,
        .bNumConfigurations = 1,
    };
    return LIBUSB_SUCCESS;
}

/* USB3 Vision: a control interface with the camera's own descriptor behind it, and a stream. */
static const uint8_t vision_descriptor[] = {
    20, 0x24, 0x01,             /* its length, and that it describes a camera */
    0x00, 0x01, 0x00, 0x00,     /* GenCP 1.0 */
    0x01, 0x00, 0x00, 0x00,     /* USB3 Vision 1.0 */
    IDENTITY, MAKER, MODEL, 0,  /* texts: identity, maker, model, family */
    0, 0, SERIAL, 0,            /* version, more, serial, name */
    0x08,                       /* super speed */
};
static const struct libusb_endpoint_descriptor control_ends[] = {
    {.bEndpointAddress = CONTROL_IN, .bmAttributes = 2, .wMaxPacketSize = 1024},
    {.bEndpointAddress = CONTROL_OUT, .bmAttributes = 2, .wMaxPacketSize = 1024},
};
static const struct libusb_endpoint_descriptor stream_ends[] = {
    {.bEndpointAddress = PICTURES_IN, .bmAttributes = 2, .wMaxPacketSize = 1024},
};
static const struct libusb_interface_descriptor control_interface = {
    .bInterfaceNumber = 0,
    .bNumEndpoints = 2,
    .bInterfaceClass = LIBUSB_CLASS_MISCELLANEOUS,
    .bInterfaceSubClass = 0x05,
    .bInterfaceProtocol = 0x00,
    .endpoint = control_ends,
    .extra = vision_descriptor,
    .extra_length = sizeof vision_descriptor,
};
static const struct libusb_interface_descriptor stream_interface = {
    .bInterfaceNumber = 1,
    .bNumEndpoints = 1,
    .bInterfaceClass = LIBUSB_CLASS_MISCELLANEOUS,
    .bInterfaceSubClass = 0x05,
    .bInterfaceProtocol = 0x02,
    .endpoint = stream_ends,
};
static const struct libusb_interface interfaces[] = {{&control_interface, 1}, {&stream_interface, 1}};
static struct libusb_config_descriptor config = {.bNumInterfaces = 2, .interface = interfaces};

int libusb_get_config_descriptor(libusb_device *d, uint8_t i, struct libusb_config_descriptor **found)
{
    (void)d, (void)i;
    *found = &config;
    return LIBUSB_SUCCESS;
}

void libusb_free_config_descriptor(struct libusb_config_descriptor *found)
{
    (void)found;
}

/* libusb: one camera opened. */

static struct camera *camera_of(const libusb_device_handle *handle)
{
    return &cameras[handle->device->camera];
}

int libusb_open(libusb_device *device, libusb_device_handle **opened)
{
    const struct camera *camera = &cameras[device->camera];
    if (!camera->plugged)
        return LIBUSB_ERROR_NO_DEVICE;
    if (camera->forbidden)
        return LIBUSB_ERROR_ACCESS;
    *opened = calloc(1, sizeof **opened);
    (*opened)->device = device;
    (*opened)->departures = camera->departures;
    return LIBUSB_SUCCESS;
}

void libusb_close(libusb_device_handle *handle)
{
    pthread_mutex_lock(&lock);
    if (camera_of(handle)->owner == handle)
        camera_of(handle)->owner = NULL;
    pthread_mutex_unlock(&lock);
    free(handle);
}

libusb_device *libusb_get_device(libusb_device_handle *handle)
{
    return handle->device;
}

int libusb_get_string_descriptor_ascii(libusb_device_handle *h, uint8_t text, unsigned char *to, int room)
{
    strncpy((char *)to, camera_of(h)->texts[text], room);
    return (int)strlen((char *)to);
}

int libusb_claim_interface(libusb_device_handle *handle, int number)
{
    (void)number;
    struct camera *camera = camera_of(handle);
    pthread_mutex_lock(&lock);
    bool free_to_take = camera->owner == NULL || camera->owner == handle;
    if (free_to_take)
        camera->owner = handle;
    pthread_mutex_unlock(&lock);
    return free_to_take ? LIBUSB_SUCCESS : LIBUSB_ERROR_BUSY;
}

int libusb_release_interface(libusb_device_handle *handle, int number)
{
    (void)handle, (void)number;
    return LIBUSB_SUCCESS;
}

int libusb_set_auto_detach_kernel_driver(libusb_device_handle *handle, int enable)
{
    (void)handle, (void)enable;
    return LIBUSB_SUCCESS;
}

int libusb_clear_halt(libusb_device_handle *handle, unsigned char endpoint)
{
    (void)handle, (void)endpoint;
    return LIBUSB_SUCCESS;
}

int libusb_control_transfer(libusb_device_handle *handle, uint8_t type, uint8_t request, uint16_t value,
                            uint16_t index, unsigned char *data, uint16_t size, unsigned int timeout_ms)
{
    (void)handle, (void)type, (void)request, (void)value, (void)index, (void)data, (void)timeout_ms;
    return size;
}

const char *libusb_error_name(int code)
{
    switch (code) {
    case LIBUSB_ERROR_TIMEOUT: return "LIBUSB_ERROR_TIMEOUT";
    case LIBUSB_ERROR_NO_DEVICE: return "LIBUSB_ERROR_NO_DEVICE";
    case LIBUSB_ERROR_ACCESS: return "LIBUSB_ERROR_ACCESS";
    case LIBUSB_ERROR_BUSY: return "LIBUSB_ERROR_BUSY";
    default: return "LIBUSB_ERROR_OTHER";
    }
}

/* Commands and their answers. */

int libusb_bulk_transfer(libusb_device_handle *handle, unsigned char endpoint, unsigned char *data, int size,
                         int *transferred, unsigned int timeout_ms)
{
    (void)timeout_ms;
    if (is_dead(handle))
        return LIBUSB_ERROR_NO_DEVICE;
    if (endpoint == CONTROL_OUT) {
        handle->reply_size = camera_of(handle)->answer(handle->device->camera, data, size, handle->reply,
                                                       MAX_REPLY_BYTES);
        *transferred = size;
        return LIBUSB_SUCCESS;
    }
    if (endpoint != CONTROL_IN || handle->reply_size == 0)
        return LIBUSB_ERROR_TIMEOUT;
    *transferred = size < handle->reply_size ? size : handle->reply_size;
    memcpy(data, handle->reply, *transferred);
    handle->reply_size = 0;
    return LIBUSB_SUCCESS;
}

/* Pictures. */

struct libusb_transfer *libusb_alloc_transfer(int packets)
{
    (void)packets;
    return calloc(1, sizeof(struct libusb_transfer));
}

static bool is_called_back(const struct libusb_transfer *transfer)
{
    for (const struct calling *each = callings; each; each = each->next)
        if (each->transfer == transfer)
            return true;
    return false;
}

void libusb_free_transfer(struct libusb_transfer *transfer)
{
    pthread_mutex_lock(&lock);
    while (is_called_back(transfer))
        pthread_cond_wait(&changed, &lock);
    pthread_mutex_unlock(&lock);
    free(transfer);
}

static void note_stream(struct camera *camera, const struct libusb_transfer *transfer)
{
    camera->stream_context = transfer->dev_handle->device->context;
    camera->stream_thread = gettid();
}

int libusb_submit_transfer(struct libusb_transfer *transfer)
{
    struct camera *camera = camera_of(transfer->dev_handle);
    struct waiting *mine = calloc(1, sizeof *mine);
    mine->transfer = transfer;
    mine->context = transfer->dev_handle->device->context;
    pthread_mutex_lock(&lock);
    note_stream(camera, transfer);
    bool dead = is_dead(transfer->dev_handle);
    if (!dead) {
        struct waiting **end = &camera->waiting;
        while (*end)
            end = &(*end)->next;
        *end = mine;
    }
    wake_up();
    if (dead)
        free(mine);
    return dead ? LIBUSB_ERROR_NO_DEVICE : LIBUSB_SUCCESS;
}

int libusb_cancel_transfer(struct libusb_transfer *transfer)
{
    int result = LIBUSB_ERROR_NOT_FOUND;
    pthread_mutex_lock(&lock);
    note_stream(camera_of(transfer->dev_handle), transfer);
    for (struct waiting *each = camera_of(transfer->dev_handle)->waiting; each; each = each->next)
        if (each->transfer == transfer) {
            each->cancelled = true;
            result = LIBUSB_SUCCESS;
        }
    wake_up();
    return result;
}

/* Let the first packet of the queue fill a transfer. */
static void fill_from_queue(struct camera *camera, struct waiting *waiting)
{
    struct packet *packet = camera->packets;
    fill(waiting, &packet->data);
    if (left_of(&packet->data) == 0) {
        camera->packets = packet->next;
        free(packet);
    }
}

/* Return whether a transfer of a context is over wherever it stands in the queue. */
static bool is_cut_short(const struct waiting *waiting, const libusb_context *context)
{
    return waiting->context == context && (waiting->cancelled || waiting->orphaned);
}

static struct waiting **first_alive(struct camera *camera)
{
    struct waiting **place = &camera->waiting;
    while (*place && ((*place)->cancelled || (*place)->orphaned))
        place = &(*place)->next;
    return place;
}

/* Take a transfer of the context that is over out of the queue: a cancelled or orphaned one
   wherever it stands, the first one when there is something for it. */
static struct libusb_transfer *take_finished(struct camera *camera, const libusb_context *context)
{
    struct waiting **place = &camera->waiting;
    while (*place && !is_cut_short(*place, context))
        place = &(*place)->next;
    if (!*place) {
        place = first_alive(camera);
        if (!*place || (*place)->context != context || (!(*place)->filled && !camera->packets))
            return NULL;
    }
    struct waiting *found = *place;
    struct libusb_transfer *transfer = found->transfer;
    if (!found->filled && is_cut_short(found, context)) {
        transfer->actual_length = 0;
        transfer->status = found->orphaned ? LIBUSB_TRANSFER_NO_DEVICE : LIBUSB_TRANSFER_CANCELLED;
    } else if (!found->filled)
        fill_from_queue(camera, found);
    *place = found->next;
    free(found);
    return transfer;
}

/* Call a transfer back; the lock is held before and after, but not meanwhile. */
static void call_back(struct libusb_transfer *transfer)
{
    struct calling here = {callings, transfer};
    callings = &here;
    pthread_mutex_unlock(&lock);
    transfer->callback(transfer);
    pthread_mutex_lock(&lock);
    struct calling **place = &callings;
    while (*place != &here)
        place = &(*place)->next;
    *place = here.next;
    pthread_cond_broadcast(&changed);
}

/* Call a finished transfer back, if there is one; the lock is held before and after. */
static bool finish_one(libusb_context *context)
{
    for (int number = 0; number < MAX_CAMERAS; number++) {
        struct libusb_transfer *over = take_finished(&cameras[number], context);
        if (over) {
            call_back(over);
            return true;
        }
    }
    return false;
}

/* Tell the context's listeners, once, of a camera that left. */
static bool tell_of_one_that_left(libusb_context *context)
{
    for (int number = 0; number < MAX_CAMERAS; number++) {
        if (context->told_departures[number] == cameras[number].departures)
            continue;
        context->told_departures[number] = cameras[number].departures;
        pthread_mutex_unlock(&lock);
        for (int each = 0; each < MAX_LISTENERS; each++)
            if (context->listeners[each].called)
                context->listeners[each].called(context, &context->devices[number],
                                                LIBUSB_HOTPLUG_EVENT_DEVICE_LEFT,
                                                context->listeners[each].user_data);
        pthread_mutex_lock(&lock);
        return true;
    }
    return false;
}

/* Make the stream threads of the context's cameras look again at what they wait for. */
static void disturb(const libusb_context *context)
{
    for (int number = 0; number < MAX_CAMERAS; number++) {
        struct camera *camera = &cameras[number];
        if (camera->stream_context == context && camera->stream_thread)
            if (syscall(SYS_tgkill, getpid(), camera->stream_thread, DISTURB) != 0)
                camera->stream_thread = 0;
    }
}

int libusb_handle_events_timeout(libusb_context *context, struct timeval *timeout)
{
    (void)timeout;
    struct timespec until;
    clock_gettime(CLOCK_MONOTONIC, &until);
    until.tv_nsec += MAX_WAIT_MS * 1000000L;
    until.tv_sec += until.tv_nsec / 1000000000L;
    until.tv_nsec %= 1000000000L;
    pthread_mutex_lock(&lock);
    while (!tell_of_one_that_left(context) && !finish_one(context))
        if (pthread_cond_clockwait(&changed, &lock, CLOCK_MONOTONIC, &until) != 0) {
            disturb(context);
            break;
        }
    pthread_mutex_unlock(&lock);
    return LIBUSB_SUCCESS;
}

int libusb_hotplug_register_callback(libusb_context *context, int events, int flags, int vendor, int product,
                                     int class, libusb_hotplug_callback_fn called, void *user_data,
                                     libusb_hotplug_callback_handle *handle)
{
    (void)events, (void)flags, (void)vendor, (void)product, (void)class;
    for (int each = 0; each < MAX_LISTENERS; each++)
        if (!context->listeners[each].called) {
            context->listeners[each] = (struct listener){called, user_data};
            if (handle)
                *handle = each + 1;
            return LIBUSB_SUCCESS;
        }
    return LIBUSB_ERROR_NO_MEM;
}

void libusb_hotplug_deregister_callback(libusb_context *context, libusb_hotplug_callback_handle handle)
{
    if (handle > 0)
        context->listeners[handle - 1].called = NULL;
}
