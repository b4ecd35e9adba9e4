#include "app/video_encoder.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <sstream>
#include <thread>

namespace noctule {

namespace {

constexpr int kNotFound = 127;            // exit code of a child whose program does not exist, as of a shell
constexpr int kPipeBytes = 1 << 20;       // a frame fits whole
constexpr auto kEndPatience = std::chrono::milliseconds(500);

std::vector<std::string> split(const std::string& text) {
    std::istringstream in(text);
    std::vector<std::string> out;
    for (std::string word; in >> word;) { out.push_back(word); }
    return out;
}

/// A child that runs `words`; input: its standard input, -1 none. -1: no process.
pid_t spawn(const std::vector<std::string>& words, const int input) {
    std::vector<char*> arguments;
    for (const std::string& word : words) { arguments.push_back(const_cast<char*>(word.c_str())); }
    arguments.push_back(nullptr);
    const pid_t parent = getpid();
    const pid_t child = fork();
    if (child != 0) { return child; }
    prctl(PR_SET_PDEATHSIG, SIGTERM);                     // it does not outlive us
    if (getppid() != parent) { _exit(kNotFound); }
    for (const int number : {SIGPIPE, SIGINT, SIGTERM}) { signal(number, SIG_DFL); }
    const int null = open("/dev/null", O_RDWR);
    dup2(input >= 0 ? input : null, STDIN_FILENO);
    dup2(null, STDOUT_FILENO);
    if (input < 0) { dup2(null, STDERR_FILENO); }
    execvp(arguments[0], arguments.data());
    _exit(kNotFound);
}

}  // namespace

std::vector<std::string> VideoEncoder::words() const {
    // Stamped on arrival: dropped frames must not slow the picture's clock down.
    std::vector<std::string> out = split("gst-launch-1.0 -q fdsrc fd=0 do-timestamp=true ! rawvideoparse format=bgr framerate=0/1");
    out.push_back("width=" + std::to_string(settings_.width_px));
    out.push_back("height=" + std::to_string(settings_.height_px));
    std::string clients;
    for (const std::string& host : settings_.hosts) { clients += (clients.empty() ? "" : ",") + host + ":" + std::to_string(settings_.port); }
    for (const std::string& word : split("! videoconvert ! video/x-raw,format=I420 ! " + settings_.element + " ! rtph264pay config-interval=1 pt=96 ! multiudpsink sync=false clients=" + clients)) {
        out.push_back(word);
    }
    return out;
}

std::string VideoEncoder::missing() const {
    const std::vector<std::string> encoder = split(settings_.element);
    for (const std::string& element : {std::string("rawvideoparse"), std::string("videoconvert"), encoder.empty() ? std::string("encoder") : encoder[0], std::string("rtph264pay"), std::string("multiudpsink")}) {
        int status = 0;
        const pid_t child = spawn({"gst-inspect-1.0", "--exists", element}, -1);
        if (child < 0 || waitpid(child, &status, 0) != child || !WIFEXITED(status) || WEXITSTATUS(status) == kNotFound) { return "gst-inspect-1.0"; }
        if (WEXITSTATUS(status) != 0) { return element; }
    }
    return {};
}

bool VideoEncoder::start() {
    stop();
    int ends[2] = {-1, -1};
    if (pipe2(ends, O_CLOEXEC) != 0) { return false; }
    child_ = spawn(words(), ends[0]);
    close(ends[0]);
    pipe_ = ends[1];
    if (child_ < 0) {
        stop();
        return false;
    }
    static_cast<void>(fcntl(pipe_, F_SETPIPE_SZ, kPipeBytes));     // a smaller one is only slower
    static_cast<void>(fcntl(pipe_, F_SETFL, O_NONBLOCK));
    return true;
}

bool VideoEncoder::running() {
    if (child_ > 0 && waitpid(child_, nullptr, WNOHANG) == child_) {
        child_ = -1;
        stop();
    }
    return child_ > 0;
}

bool VideoEncoder::put(const std::span<const std::uint8_t> frame) {
    tend();
    if (pipe_ < 0 || busy()) { return false; }
    frame_.assign(frame.begin(), frame.end());
    sent_ = 0;
    tend();
    return true;
}

void VideoEncoder::tend() {
    while (pipe_ >= 0 && busy()) {
        const ssize_t n = write(pipe_, frame_.data() + sent_, frame_.size() - sent_);
        if (n <= 0) { return; }                                     // full, or the child has ended: running() tells
        sent_ += static_cast<std::size_t>(n);
    }
}

void VideoEncoder::stop() {
    if (pipe_ >= 0) { close(pipe_); }
    pipe_ = -1;
    frame_.clear();
    sent_ = 0;
    if (child_ <= 0) { return; }
    kill(child_, SIGTERM);
    const auto end = std::chrono::steady_clock::now() + kEndPatience;
    while (waitpid(child_, nullptr, WNOHANG) == 0) {
        if (std::chrono::steady_clock::now() > end) { kill(child_, SIGKILL); }
        std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    child_ = -1;
}

}  // namespace noctule
